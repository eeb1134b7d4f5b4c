"""The README's commands and Python, run from top to bottom in a fresh folder: `python -m tests.readme_commands`.

`--install` first installs merlfit into an empty environment in that folder. `--quick` fits one kind of material with a
short chain, and leaves out what the README calls slow: `--preset conserving` and `cost`, which are to be run by hand.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
SLOW = ("slow", "half an hour")  # words of a comment
SHORT = '[effects]\nbody = "none"\n[posterior]\nmax_steps = 60\n'
MAY_FAIL = "merlfit sample"  # exits with 1 where the chain is still too short, as it does here with so few steps


def commands(text):
    """Lines of its indented blocks that call merlfit: command and comment."""
    lines = re.findall(r"^    (merlfit [^#\n]*)(?:#(.*))?$", text, re.MULTILINE)
    return [(command.strip(), comment.strip()) for command, comment in lines]


def programs(text):
    """Its Python blocks."""
    return re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def shortened(command):
    """The same with settings that take less time."""
    long = command.startswith("merlfit fit ") and "--model " not in command  # the settings are of the two-scale model
    return f"{command} --config short.toml" if long else command


def install(folder):
    """An environment of its own with merlfit in it; the folder of its programs."""
    subprocess.run([sys.executable, "-m", "venv", folder / "env"], check=True)
    pip = [folder / "env" / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--constraint", ROOT / "constraints.txt", f"{ROOT}[arviz]"], check=True)
    return folder / "env" / "bin"


def run(folder, programs_in, quick, text=None):
    """Run all; what failed, in words."""
    text, failed = (ROOT / "README.md").read_text() if text is None else text, []
    environment = {**os.environ, "PATH": f"{programs_in}{os.pathsep}{os.environ['PATH']}"}
    (folder / "short.toml").write_text(SHORT)
    shutil.copytree(ROOT / "configs", folder / "configs", dirs_exist_ok=True)  # as in a clone

    def call(said, words, allowed=(0,)):
        start = time.perf_counter()
        print(f"$ {said}", flush=True)
        code = subprocess.run(words, cwd=folder, env=environment).returncode
        print(f"-> {code}, {time.perf_counter() - start:.0f} s", flush=True)
        if code not in allowed:
            failed.append(f"{said}: exit code {code}")

    for command, comment in commands(text):
        if quick and any(word in comment for word in SLOW):
            continue
        line = shortened(command) if quick else command
        call(line, ["sh", "-c", line], (0, 1) if line.startswith(MAY_FAIL) else (0,))
    for program in programs(text):
        call("python", [programs_in / "python", "-c", program])
    return failed


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--install", action="store_true")
    parser.add_argument("--quick", action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        programs_in = install(folder) if asked.install else Path(sys.executable).parent
        failed = run(folder, programs_in, asked.quick)
    sys.exit("\n".join(failed) if failed else 0)


if __name__ == "__main__":
    main()
