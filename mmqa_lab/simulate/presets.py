"""Scanners as their makers describe them; mount and vary them with ``dataclasses.replace``.

They stand in ``presets.toml`` beside this module. Each says where its numbers come from and whether
they are nominal or calibrated.
"""

import tomllib
from importlib.resources import files

from mmqa_lab.simulate.scanners import MultiBeamScanner, ProfileScanner


def _read():
    """The scanners of the file by name."""
    entries = tomllib.loads(files(__package__).joinpath("presets.toml").read_text("utf-8"))
    found = {}
    for name, entry in entries.items():
        entry = {**entries.get(entry.pop("like", None), {}), **entry}
        if "elevations_deg" in entry:
            entry["elevations_deg"] = tuple(entry["elevations_deg"])
            found[name] = MultiBeamScanner(**entry)
        else:
            entry["field_of_view_deg"] = tuple(entry.get("field_of_view_deg", (-180.0, 180.0)))
            found[name] = ProfileScanner(**entry)
    return found


PRESETS = _read()
"""Presets by the name that the command line knows."""

ZF_9012, ZF_9012_FITTED = PRESETS["zf-9012"], PRESETS["zf-9012-fitted"]
HDL_32E, ROAMER, VQ_450 = PRESETS["hdl-32e"], PRESETS["roamer"], PRESETS["vq-450"]
VQ_250, LYNX_M1, LYNX_M1_SECOND = (PRESETS[k] for k in ("vq-250", "lynx-m1", "lynx-m1-second"))
