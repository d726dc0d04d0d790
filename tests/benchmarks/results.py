"""Each benchmark writes its table into its own section of RESULTS.md."""

import re
import subprocess
from pathlib import Path

from mmqa_lab import __version__

FILE = Path(__file__).with_name("RESULTS.md")

HEAD = "# Results of the benchmarks\n\nEach script of this folder writes its own section.\n"


def write_section(title, table):
    """Put a DataFrame under a heading of its own, in place of the section that stood there."""
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=FILE.parent, capture_output=True, text=True
    ).stdout.strip()
    frame = table.reset_index() if any(table.index.names) else table
    lines = [list(frame.columns), ["---"] * len(frame.columns), *frame.itertuples(index=False)]
    rows = ["| " + " | ".join(_cell(one) for one in line) + " |" for line in lines]
    section = f"## {title}\n\nVersion {__version__}, commit {commit}.\n\n"
    section += "\n".join(rows) + "\n"
    text = FILE.read_text(encoding="utf-8") if FILE.exists() else HEAD
    head, *old = re.split(r"(?m)^(?=## )", text)
    kept = [one.strip() + "\n" for one in old if not one.startswith(f"## {title}\n")]
    FILE.write_text("\n".join([head.strip() + "\n", *sorted([*kept, section])]), encoding="utf-8")


def _cell(value):
    """A number with four digits, or text."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
