"""The list of rooms on the contributors' page, from docstrings: python tests/rooms.py writes it."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- rooms: written by tests/rooms.py -->", "<!-- end of rooms -->"


def _says(path):
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))).split("\n")[0]


def rooms():
    """Lines of the list: the groups of the package, in each its rooms, with a line a file."""
    package, lines = ROOT / "mmqa_lab", []
    for line in ast.get_docstring(ast.parse((package / "__init__.py").read_text())).split("\n"):
        if line.endswith(":"):
            lines += ["", f"**{line[:-1]}**", ""]
        if room := re.match(r"- ``(\w+)``: ", line):
            folder = package / room[1]
            start = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
            lines.append(f"- `{room[1]}`: {_says(start)}")
            inner = sorted({*folder.rglob("*.py")} - {*folder.rglob("__init__.py")})
            names = ((path.relative_to(folder).with_suffix("").as_posix(), path) for path in inner)
            lines += [f"  - `{name}`: {_says(path)}" for name, path in names]
    return "\n".join([*lines[1:], ""])


def with_rooms(page):
    """The page with the list as the docstrings are now."""
    before, _, rest = page.partition(BEGIN)
    return before + BEGIN + "\n\n" + rooms() + "\n" + END + rest.partition(END)[2]


if __name__ == "__main__":
    page = ROOT / "CONTRIBUTING.md"
    page.write_text(with_rooms(page.read_text(encoding="utf-8")), encoding="utf-8")
