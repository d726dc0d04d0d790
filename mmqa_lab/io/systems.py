"""Coordinate systems that files name, with the units that stand beside their names."""

from __future__ import annotations

import re
import warnings

__all__ = ["las_system", "named_system", "system_of_keys"]

# GeoTIFF keys of LAS files (OGC 19-008r4).
MODEL, PLAN_UNIT, HEIGHT_SYSTEM, HEIGHT_UNIT = 1024, 3076, 4096, 4099
DEGREES = 2
USER_DEFINED = 32767


def named_system(name, what):
    """Return the coordinate system of this name or number; a sentence if it is not known."""
    import pyproj

    try:
        return pyproj.CRS(name)
    except pyproj.exceptions.CRSError as error:
        found, wanted = f"system {str(name)[:80]!r}", "a coordinate system that is known"
        raise ValueError(f"Invalid {what} with {found}. Must name {wanted}.") from error


def system_of_keys(keys, crs, what):
    """A coordinate system with the heights and units that GeoTIFF keys, {number: value}, add.

    A unit beside a system in metres is that of the coordinates: it makes a local system.
    """
    import pyproj

    if crs is None and keys.get(MODEL) == DEGREES:
        return named_system("+proj=longlat +ellps=WGS84", what)
    unit, height_unit = _unit(keys.get(PLAN_UNIT)), _unit(keys.get(HEIGHT_UNIT))
    stated = 1 if crs is None else crs.axis_info[0].unit_conversion_factor
    if unit is not None and unit.conv_factor != 1 == stated:
        crs = _local(unit.name, unit.conv_factor)
    if crs is not None and crs.is_compound:
        return crs
    if height_unit is not None and height_unit.conv_factor != 1:
        size = f'UNIT["{height_unit.name}",{height_unit.conv_factor!r}]'
        axis = f'VERT_CS["heights",VERT_DATUM["unknown",2005],{size},AXIS["Up",UP]]'
        heights = pyproj.CRS(axis)
    elif 1024 < keys.get(HEIGHT_SYSTEM, 0) < USER_DEFINED:
        heights = named_system(keys[HEIGHT_SYSTEM], what)
    else:
        return crs
    crs = crs or _local("metre", 1.0)
    return pyproj.crs.CompoundCRS(f"{crs.name} + {heights.name}", [crs, heights])


def las_system(header, path):
    """Return the coordinate reference system that a LAS header names; None without one."""
    found = [*header.vlrs.get_by_id("LASF_Projection")]
    found += [] if header.evlrs is None else header.evlrs.get_by_id("LASF_Projection")
    keys = {key.id: key.value_offset for one in found for key in getattr(one, "geo_keys", [])}
    texts = " ".join(getattr(one, "string", "") for one in found)
    crs = None
    try:
        crs = header.parse_crs()
    except Exception:  # of pyproj and of whatever its text is given to
        unit, size = (re.findall(r'UNIT\["([^"]*)",\s*([-+.\deE]+)', texts) or [("metre", "1")])[-1]
        if float(size) != 1:
            return _local(unit, float(size))
        warnings.warn(f"{path} names a coordinate system that is not known.", stacklevel=2)
    return system_of_keys(keys, crs, f"cloud {path}") if keys else crs


def _unit(number):
    """The EPSG unit of a number; None without one."""
    from pyproj.database import get_units_map

    units = get_units_map(auth_name="EPSG", category="linear") if number else {}
    return next((unit for unit in units.values() if unit.code == str(number)), None)


def _local(unit, factor):
    """A system without a place on the globe, in this unit."""
    import pyproj

    axes = f'AXIS["easting",EAST],AXIS["northing",NORTH],LENGTHUNIT["{unit}",{factor!r}]'
    return pyproj.CRS(f'ENGCRS["unknown",EDATUM["unknown"],CS[Cartesian,2],{axes}]')
