"""What one section measures in a process of its own: `python -m tests.bench.worker SECTION ARGUMENT ...`, JSON."""

import importlib
import json
import sys

from merlfit.fitting.support.compilation import use_persistent_cache

if __name__ == "__main__":
    use_persistent_cache()
    section = importlib.import_module(f"{__package__}.{sys.argv[1]}")
    print(json.dumps(section.measure(*sys.argv[2:]), default=float))
