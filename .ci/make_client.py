"""Makes `gaitway/client/` from `gaitway/async_client/`, so that both clients have one source.

`--check` changes nothing, and fails where `gaitway/client/` is not what it would make.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE, MADE = ROOT / "gaitway" / "async_client", ROOT / "gaitway" / "client"
RUFF = Path(sys.executable).with_name("ruff")
_DOCSTRING = re.compile(r'(""".*?""")', re.DOTALL)
_RULES = [
    (r"for (\w+) in ([^\n]+):\n +yield \1\n", r"yield from \2\n"),
    (r"\basync (?=def |with |for )", ""),
    (r"\bawait ", ""),
    (r"\basync_client\b", "client"),
    (r"\basync_?(?=[a-z])", ""),  # async_sleep, asynccontextmanager
    (r"\bAsync(?=[A-Z])", ""),  # AsyncClient, AsyncIterator
    (r"\b__a(?=enter__|exit__)", "__"),
    (r"\ba(?=read\(|close\(|iter_bytes\(|iter_raw\()", ""),
]


def synchronous(source: Path) -> str:
    """The module without `async`, formatted."""
    parts = _DOCSTRING.split(source.read_text())
    for number in range(0, len(parts), 2):  # docstrings stand between
        for pattern, replacement in _RULES:
            parts[number] = re.sub(pattern, replacement, parts[number])
    text = f"# Made by .ci/make_client.py: change {source.relative_to(ROOT)} instead.\n" + "".join(parts)
    for tool in (["check", "--quiet", "--select", "I", "--fix"], ["format", "--quiet"]):
        command = [RUFF, *tool, "--stdin-filename", MADE / source.name, "-"]
        made = subprocess.run(command, input=text, capture_output=True, text=True, check=True, cwd=ROOT)
        text = made.stdout
    return text


def main() -> int:
    wanted = {MADE / source.name: synchronous(source) for source in sorted(SOURCE.glob("*.py"))}
    present = {path: path.read_text() for path in MADE.glob("*.py")}
    if wanted == present:
        return 0
    if "--check" in sys.argv:
        sys.stderr.write("gaitway/client is not up to date: run ./run fmt\n")
        return 1
    MADE.mkdir(exist_ok=True)
    for path in present.keys() - wanted.keys():
        path.unlink()
    for path, text in wanted.items():
        path.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
