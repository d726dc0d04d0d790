"""Clouds in E57 files: every scan at its pose."""

from __future__ import annotations

import numpy as np

from mmqa_lab._checks import needs, refuse, type_step
from mmqa_lab.io.files import reading
from mmqa_lab.io.marks import Piece

__all__ = ["e57_pieces"]

E57 = "a complete E57 file with scans of points"

# Fields that are no columns, and the names of those that LAS has, too.
CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ", "cartesianInvalidState")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation", "sphericalInvalidState")
E57_COLUMNS = {"colorRed": "red", "colorGreen": "green", "colorBlue": "blue"}
E57_COLUMNS |= {"rowIndex": "row", "columnIndex": "column", "timeStamp": "time"}

# A packet holds constant fields in no bits: so many points of a byte are still believed.
MOST_PER_BYTE = 64


def e57_pieces(path, scan=None):
    """The scans of an E57 file, or the one of this number or name; numbers in a column ``scan``."""
    pye57 = needs("files", "pye57")
    with reading(path, "cloud", E57):
        file = pye57.E57(str(path))
        headers = [file.get_header(number) for number in range(file.scan_count)]
        total = sum(header.point_count for header in headers)
    what, most = f"cloud {path}", MOST_PER_BYTE * path.stat().st_size
    refuse(not headers, what, "no scans", E57)
    refuse(total > most, what, f"{total} points in so few bytes", E57)
    for number, header in enumerate(headers):
        if scan is not None and str(scan) not in (str(number), _name(header)):
            continue
        with reading(path, "cloud", E57):
            places = CARTESIAN if CARTESIAN[0] in header.point_fields else SPHERICAL
            known = pye57.e57.SUPPORTED_POINT_FIELDS
            data, buffers = file.make_buffers(
                [field for field in header.point_fields if field in known], header.point_count
            )
            reader = header.points.reader(buffers)
            read = reader.read() if header.point_count else 0
            reader.close()
            stored = np.stack([data.pop(field) for field in places[:3]], axis=1)
            if places is SPHERICAL:
                stored = pye57.utils.convert_spherical_to_cartesian(stored)
            pose = header.has_pose()
            points = file.to_global(stored, header.rotation, header.translation) if pose else stored
        found = f"{read} points where its header says {header.point_count}"
        refuse(read != header.point_count, what, found, "as many")
        invalid = data.pop(places[3], np.zeros(read, np.int8)) != 0
        columns = {E57_COLUMNS.get(field, field): values for field, values in data.items()}
        single = np.isfinite(stored).all() and (stored == stored.astype(np.float32)).all()
        step = type_step(stored.astype(np.float32)) if single and read else np.nan
        yield Piece(
            np.asarray(points, dtype=np.float64),
            {**columns, "scan": np.full(read, number)},
            {"resolution": step},
            total,
            {"their scanner marked as invalid": invalid},
        )


def _name(header):
    """The name of a scan; "" for none."""
    return header["name"].value() if header.node.isDefined("name") else ""
