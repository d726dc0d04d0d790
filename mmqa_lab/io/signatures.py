"""What a file is by its first bytes or its ending, and what to do with one that is not read."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["PTX_HEAD", "RAW_ENDINGS", "WEB_PAGE", "form_of", "refuse_unread"]

# Columns and rows of a scan, the scanner's place and axes, and the matrix to the common system.
PTX_HEAD = re.compile(
    rb"\s*(\d+)[ \t]*\n[ \t]*(\d+)[ \t]*\n((?:[^\s]+[ \t]+){2}[^\s]+[ \t]*\n){4}"
    rb"(((?:[^\s]+[ \t]+){3}[^\s]+[ \t]*\n){4})"
)

# The readers of clouds by how files begin, whatever their ending says.
BEGUN = {"e57": rb"ASTM-E57", "las": rb"LASF", "ply": rb"(\xef\xbb\xbf)?ply\s"}
BEGUN |= {"pcd": rb"# \.PCD|VERSION \.?\d[^\n]*\n(#.*\n)*FIELDS ", "ptx": PTX_HEAD.pattern}

# Photographs as their sensors saw them; DNG is read.
RAW_ENDINGS = (
    ".cr2 .cr3 .crw .nef .nrw .arw .srf .sr2 .raf .orf .rw2 .pef .srw .x3f .3fr .iiq .erf .mrw"
)

WEB_PAGE = rb"\s*<(!doctype )?html"

# What is not read: how it begins, its endings, its name, and what to do.
UNREAD = (
    (rb"FUJIFILM|IIRO|IIU\0|FOVb|MM\0\*.{4}Ph|II\*\0.{4}CR|....ftypcrx", RAW_ENDINGS,
     "a RAW photograph", "save it as TIFF of 16 bits"),
    (WEB_PAGE, ".html .htm", "a web page", "download the file itself"),
    (None, ".xlsx .xlsm .ods", "a workbook", "save its sheet as CSV"),
    (rb"PK\x03\x04", ".zip .kmz .7z .rar", "a compressed archive", "unpack it"),
    (rb"\x1f\x8b", ".gz .tgz", "a compressed archive", "unpack it"),
    (rb"\s*ncols\s+\d+", "", "an ESRI grid", "give it as reference heights"),
    (rb"SQLite format 3", ".gpkg", "a GeoPackage", "give it as --polygon"),
    (rb"\0\0\x27\x0a", ".shp", "a shapefile", "give it as --polygon"),
    (rb"fgb\x03fgb", ".fgb", "a FlatGeobuf", "give it as --polygon"),
    (rb"II\*\0|MM\0\*", "", "a TIFF file", "give it as an image or as reference heights"),
    (rb"\x89HDF|CDF[\1\2]", ".h5 .nc", "an HDF or NetCDF file", "save it as LAS or text"),
    (rb"#ROSBAG|\x89MCAP", ".bag .mcap .db3", "a robot's log", "save its clouds as PCD"),
    (rb"\xd4\xc3\xb2\xa1|\n\r\r\n", ".pcap .pcapng", "packets", "save them as LAS or PCD"),
    (rb"\xd0\xcf\x11\xe0", ".xls", "an old Excel workbook", "save it as XLSX or CSV"),
    (rb"AC10\d\d", ".dwg", "a DWG drawing", "save it as DXF"),
    (rb"\0\0\0.ftyp(heic|heix|mif1)", ".heic .heif", "a HEIC photograph", "save it as JPEG"),
    (rb"<\?xml|<kml", ".kml", "an XML file", "give outlines as --polygon"),
    (rb"%PDF", ".pdf", "a PDF", "save its tables as CSV"),
    (None, ".rcp .rcs .fls .lsproj .zfs .rxp .ptg .bin .cl3 .fws", "a scanner's own format",
     "save it as E57 or LAS"),
    (None, ".obj .stl .off .glb .gltf .fbx", "a mesh", "save its points as PLY"),
    (None, ".npy .npz .mat .pkl .parquet", "an array", "save it as LAS or CSV"),
)  # fmt: skip


def form_of(path):
    """Which reader of clouds a file belongs to by its first bytes; "" if they tell none."""
    with Path(path).open("rb") as file:
        head = file.read(4096)
    return next((name for name, mark in BEGUN.items() if re.match(mark, head)), "")


def refuse_unread(path, name, *, others=None):
    """Raise a sentence that names the format of a file that is not read, if it is known.

    ``others`` are the endings that tell it, too; None for all of the table.
    """
    with Path(path).open("rb") as file:
        head = file.read(4096)
    ending = Path(path).suffix.lower()
    for mark, ends, what, instead in UNREAD:
        begins = mark is not None and re.match(mark, head, re.DOTALL | re.IGNORECASE)
        if begins or (ending in ends.split() and (others is None or ends == others)):
            raise ValueError(f"Invalid {name} {path}: {what}. Must be another; {instead}.")
