"""What moved between two folders of results, cell by cell: python tests/benchmarks/same.py A B."""

import sys
from pathlib import Path

import pandas as pd


def moved(old, new):
    """Yield a line for each table and column that differs between two folders of results."""
    for name in sorted(
        {path.relative_to(top) for top in (old, new) for path in top.rglob("*.csv")}
    ):
        files = [top / name for top in (old, new) if (top / name).is_file()]
        if len(files) < 2:
            yield f"{name}: only in {files[0].parent}"
            continue
        before, after = map(pd.read_csv, files)
        if list(before.columns) != list(after.columns) or len(before) != len(after):
            new_names = sorted(set(before.columns) ^ set(after.columns))
            yield f"{name}: {len(before)} rows, now {len(after)}; columns come or gone {new_names}"
            continue
        for column in before:
            a, b = before[column], after[column]
            other = (a != b) & ~(a.isna() & b.isna())
            if other.any():
                row = other.idxmax()
                yield f"{name} {column}: {other.sum()} of {len(a)}, first {a[row]}, now {b[row]}"


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    print(*moved(*map(Path, sys.argv[1:])), sep="\n")
