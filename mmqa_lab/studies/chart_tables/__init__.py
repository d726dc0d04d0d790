"""Chart metrics, Pfeifer et al. 2021: Table 2 from point clouds, Table 1 from images.

``points`` holds the published Table 2 and real clouds, ``systems`` the same table from
specifications.
"""

from mmqa_lab.studies.chart_tables import points, systems

QUICK = systems.QUICK


def claims(measured, check, simulated):
    """Test what the notebook says.

    Parameters
    ----------
    measured, check : DataFrame
        Of ``points.compute`` and of the published table's check.
    simulated : tuple
        The arguments of ``systems.claims``.
    """
    return [*points.claims(measured, check), *systems.claims(*simulated)]
