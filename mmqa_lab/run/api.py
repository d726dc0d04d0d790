"""The page of the public names: each with the first sentence of its docstring."""

import ast
import re
from pathlib import Path

import pandas as pd

import mmqa_lab

__all__ = ["public_names"]

PACKAGE = Path(mmqa_lab.__file__).parent


def public_names() -> pd.DataFrame:
    """Return the public names of the package, in the order of its rooms.

    They are read from the source, so nothing is imported. A room's names are those of ``__all__``
    in its module, or in the modules of its folder.

    Returns
    -------
    DataFrame of str
        ``module``, ``name`` and ``purpose``, the first sentence of the docstring.

    Examples
    --------
    >>> names = public_names()
    >>> names[names["name"] == "sigma_mad"].values.tolist()[0][:2]
    ['mmqa_lab.planes', 'sigma_mad']
    """
    rooms = re.findall(r"^- ``(\w+)``: ", mmqa_lab.__doc__, re.MULTILINE)
    rows = []
    for room in rooms:
        folder = PACKAGE / room
        for file in sorted(folder.rglob("*.py")) if folder.is_dir() else [PACKAGE / f"{room}.py"]:
            parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
            module = ".".join(parts).removesuffix(".__init__")
            if not any(part.startswith("_") for part in module.split(".")):
                rows += [(module, *row) for row in _names_of(file)]
    return pd.DataFrame(rows, columns=["module", "name", "purpose"])


def _names_of(file):
    """The names that a file defines and offers, with their first sentences."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    offered = set()
    for node in tree.body:
        targets = getattr(node, "targets", [getattr(node, "target", None)])
        if any(getattr(target, "id", "") == "__all__" for target in targets):
            parts = ast.walk(node.value)
            offered |= {part.value for part in parts if isinstance(part, ast.Constant)}
    for node in tree.body:
        if getattr(node, "name", None) in offered:
            text = " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
            text = re.sub(r":\w+:`~?([^`]*)`|``", lambda found: found[1] or "", text)
            yield node.name, re.split(r"(?<=[.;])\s", text)[0].rstrip(";")
