"""Checks of coordinate reference systems."""

__all__ = ["check_same_crs", "check_upright"]


def check_same_crs(name, crs, other_name, other):
    """Raise where a coordinate reference system differs from another or is not in metres.

    What is not known, None, agrees with all; so do heights that one of both does not name.

    Examples
    --------
    >>> import pyproj
    >>> utm32, utm33 = pyproj.CRS("EPSG:25832"), pyproj.CRS("EPSG:25833")
    >>> check_same_crs("polygon", utm33, "cloud", utm32)
    Traceback (most recent call last):
    ValueError: Invalid polygon in ETRS89 / UTM zone 33N. Must be in ETRS89 / UTM zone 32N, the
    cloud's.
    """
    if crs is None:
        return
    ours, theirs = (one.sub_crs_list if one.is_compound else [one] for one in (crs, other or crs))
    for part, wanted in zip(ours, theirs, strict=False):  # in plan, and heights where both name one
        if part.name != wanted.name and not part.equals(wanted, ignore_axis_order=True):
            must = f"{wanted.name}, the {other_name}'s"
            raise ValueError(f"Invalid {name} in {part.name}. Must be in {must}.")
    for axis in crs.axis_info:
        if axis.unit_conversion_factor != 1:
            odd = f"{'with heights ' if axis.direction == 'up' else ''}in {axis.unit_name}"
            raise ValueError(f"Invalid {name} {odd} ({crs.name}). Must be projected, in metres.")


def check_upright(name, crs):
    """Raise where the third coordinate is not the height: in a geocentric system.

    Examples
    --------
    >>> import pyproj
    >>> check_upright("cloud", pyproj.CRS("EPSG:4978"))
    Traceback (most recent call last):
    ValueError: Invalid cloud in geocentric WGS 84. Must have z upwards.
    """
    if crs is not None and crs.is_geocentric:
        raise ValueError(f"Invalid {name} in geocentric {crs.name}. Must have z upwards.")
