"""Neural reconstructions of the MERL materials (Sztrajman et al. 2021), not measurements, from ../shared/data."""

import importlib.util
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

ORIGIN = "neural reconstructions of MERL (Sztrajman et al. 2021)"
DATA = Path(__file__).parents[3] / "shared" / "data"
SCRIPT = DATA / "make_merl.py"
ABSENT = f"the neural reconstructions of MERL are absent: {Path('..', 'shared', 'data')} beside the project holds them"


def there():
    """Whether script and networks are there."""
    return SCRIPT.is_file() and (DATA / "merl_networks.npz").is_file()


@cache
def maker():
    """The module that makes MERL files of them.

    Raises:
        SystemExit: they are absent.
    """
    if not there():
        raise SystemExit(ABSENT)
    spec = importlib.util.spec_from_file_location("make_merl", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def make(folder, material):
    """Path of the MERL file of one material, made in the folder; 35 MB."""
    with redirect_stdout(None):  # it prints the path
        maker().main(folder, material)
    return Path(folder) / f"{material}.binary"
