"""The command that compares edges."""

from pathlib import Path

from mmqa_lab.commands.machine import (
    progress,
    table,
)

__all__ = ["lhd"]


@table
def lhd(
    files: list[Path],
    /,
    *,
    reference: Path | None = None,
    weight: float = 10.0,
    radius: float = 4.0,
    matcher: str = "all",
):
    """Line-segment Hausdorff distances between sets of 3-D edges, both ways.

    Every set is compared with every other, and with the reference. The published method pairs all
    segments below a threshold (Poreba & Goulette 2013, hal-00846334). The value contains the noise
    of angles and ends, and false pairs, as well as displacement: compare it with the perpendicular
    part and the displacement beside it.

    Parameters
    ----------
    files
        Segments (CSV with x1,y1,z1,x2,y2,z2, m) or clouds, whose edges are extracted first.
    reference
        Edges or cloud of the static survey, the reference.
    weight
        Weight of the angle in the distance.
    radius
        Largest displacement that is searched for, m.
    matcher
        How segments are paired: all, nearest, mutual, hungarian, fragments or displaced.
    """
    from mmqa_lab import io, lines

    files = [*files, *([] if reference is None else [reference])]
    names = [file.stem for file in files]
    names = names if len(set(names)) == len(names) else [str(file) for file in files]
    sets = {}
    for name, file in zip(names, progress(files, "file"), strict=True):
        if file.suffix.lower() in (".csv", ".txt"):
            sets[name] = io.read_segments(file)
        else:
            sets[name] = lines.extract_edges(io.read_cloud(file, columns=()).points).segments
    wanted = None if reference is None else names[-1]
    return lines.compare(sets, reference=wanted, radius=radius, weight=weight, matcher=matcher)
