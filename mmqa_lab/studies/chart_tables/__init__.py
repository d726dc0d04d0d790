"""Chart metrics, Pfeifer et al. 2021: Table 2 from point clouds, Table 1 from images.

``points`` holds the published Table 2 and real clouds, ``systems`` the same table from
specifications, ``images`` Table 1 from specifications and photographs.
"""

from mmqa_lab.studies import chart_images as images
from mmqa_lab.studies.chart_tables import points, systems

QUICK = {**systems.QUICK, **images.QUICK}


def checks(measured, check, simulated, imaged):
    """Test what the notebook says.

    Parameters
    ----------
    measured, check : DataFrame
        Of ``points.compute`` and of the published table's check.
    simulated, imaged : tuple
        The arguments of ``systems.checks`` and of ``images.checks``.
    """
    yield from points.checks(measured, check)
    yield from systems.checks(*simulated)
    yield from images.checks(*imaged)
