"""The selections that a tool keeps under names: a list, one table, files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import ipywidgets
import numpy as np
import pandas as pd

from mmqa_lab import io
from mmqa_lab.chart_cloud import CloudQuality
from mmqa_lab.widgets.screen import WIDE, in_turn

__all__ = ["Kept", "KeptSelection"]


@dataclass(frozen=True)
class KeptSelection:
    """A selection: its cloud, the number of its plane, its polygon, thickness and quality."""

    cloud: str
    plane: int
    polygon: np.ndarray
    thickness: float
    quality: CloudQuality

    def is_at(self, cloud: str, plane: int, polygon: np.ndarray, thickness: float) -> bool:
        """Return whether these are its cloud, plane, polygon and thickness."""
        place = self.cloud, self.plane, self.thickness
        return place == (cloud, plane, thickness) and np.array_equal(self.polygon, polygon)


class Kept:
    """The kept selections of a tool, by name.

    Parameters
    ----------
    tool : SurfaceTool

    Attributes
    ----------
    selections : dict of str to KeptSelection
    box : ipywidgets.Widget
        Name, button and list, as a notebook shows them.
    """

    def __init__(self, tool: Any):
        self._tool, self.selections = tool, {}
        look = {"style": {"description_width": "4em"}, "layout": {"width": "24em"}}
        self._name = ipywidgets.Text(description="name", placeholder="by itself", **look)
        self._list = ipywidgets.Select(description="kept", rows=5, **look)
        keep = ipywidgets.Button(description="Keep this selection", layout=WIDE)
        drop = ipywidgets.Button(description="Forget the one in the list", layout=WIDE)
        keep.on_click(lambda _: self.keep(self._name.value))
        drop.on_click(lambda _: self.forget(self._list.value))
        self._list.observe(self._listed, names="value")
        sides = [ipywidgets.VBox([self._name, keep, drop]), self._list]
        self.box = ipywidgets.HBox(sides, layout={"flex_flow": "row wrap"})

    @in_turn()
    def keep(self, name: str = "") -> str:
        """Keep the present selection, and return its name: one that no other has.

        Without a name, a selection that is kept already keeps its own.
        """
        tool = self._tool
        place = tool.name, tool.number, tool.vertices, tool.choices["thickness"]
        same = [own for own, one in self.selections.items() if one.is_at(*place)]
        if same and not name.strip():
            return same[0]
        wanted = name.strip() or tool.planes.loc[tool.row, "kind"]
        taken, number = wanted if name.strip() else f"{wanted} 1", 1
        while taken in self.selections:
            number += 1
            taken = f"{wanted} {number}"
        self.selections[taken] = KeptSelection(*place, tool.evaluate())
        self._changed(taken)
        return taken

    @in_turn()
    def forget(self, name: str | None) -> None:
        """Forget a selection."""
        self.selections.pop(name, None)
        self._changed(None)

    @in_turn()
    def choose(self, name: str | None) -> None:
        """Show a kept selection again."""
        one, tool = self.selections.get(name), self._tool
        if one is not None and not np.array_equal(one.polygon, tool.vertices):
            tool.choose(one.cloud, one.plane)
            tool.choices["thickness"] = one.thickness
            tool.select(one.polygon)

    def table(self) -> pd.DataFrame:
        """Return a row for each selection: its name, its cloud and its figures."""
        rows = [
            one.quality.to_frame().assign(
                thickness_m=one.thickness, remarks=" ".join(one.quality.remarks), cloud=one.cloud
            )
            for one in self.selections.values()
        ]
        if not rows:
            return pd.DataFrame({"selection": []})
        whole = pd.concat(rows, ignore_index=True)
        whole.insert(0, "cloud", whole.pop("cloud"))
        whole.insert(0, "selection", list(self.selections))
        return whole

    def write(self, path: str | os.PathLike, cloud: str = "") -> None:
        """Write the polygons on a cloud with their names, as GeoPackage or GeoJSON (.geojson).

        The cloud is the chosen one by default; those of another may have other coordinates.
        """
        cloud = cloud or self._tool.name
        polygons = {
            name: one.polygon for name, one in self.selections.items() if one.cloud == cloud
        }
        io.write_outlines(path, polygons, crs=self._tool.crs_of(cloud))

    def read(self, path: str | os.PathLike) -> None:
        """Keep the polygons of a file under their names, each on the plane that it lies on."""
        crs = self._tool.crs_of(self._tool.name)
        for name, polygon in io.read_outlines(path, crs=crs):
            self._tool.choose(self._tool.name, self._tool.plane_at(polygon))
            self._tool.select(polygon)
            self.keep(name)

    def _changed(self, name):
        """Show the list, and the outlines in the picture."""
        self._list.unobserve(self._listed, names="value")  # new options choose the first
        self._list.options, self._name.value = list(self.selections), ""
        self._list.value = name
        self._list.observe(self._listed, names="value")
        self._tool.draw_kept()

    def _listed(self, change):
        """Choose what is chosen in the list."""
        self.choose(change["new"])
