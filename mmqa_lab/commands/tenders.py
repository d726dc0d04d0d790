"""The command that compares results with criteria."""

from mmqa_lab.commands.machine import (
    table,
)

__all__ = ["tender"]


@table
def tender(criteria: str, results: str, /, *, details: bool = False):
    """Compare systems' results with the criteria of a tender, in a sentence for each system.

    The command judges any figures; it advises none. Which figure goes with which task, study 12
    says: e95_of_3 with small things and gaps, noise_of_a_mean with heights, steps and planes.
    Neither f nor g says what a cloud is fit for.

    Quantities: each metric of evaluate --metrics all, density_per_m2, sigma_mad_mm, std_mm, d1_mm
    to d4_mm, e95_mm (of a cloud); pixel_mm, w_mm, legibility, legibility_40mm, legibility_60mm (of
    a photograph); or your own, in both files. Legibility has marks, better first: a each letter can
    be read, b the text can be read, c it cannot. At least b is written >= b or <= b: both mean a or
    b. A figure is asked for because of what shall be done with the data.

    Parameters
    ----------
    criteria
        CSV file with criterion, quantity, relation (>=, >, <=, <), threshold and, where they
        matter, distance_m, view (orthogonal, forward, backward), direction (h, v), rho0_per_m2 (of
        f: the density from which it does not matter). Or pfeifer2021:test, pfeifer2021:1,
        pfeifer2021:2: the test and both scenarios of Pfeifer et al. 2021 (doi
        10.3390/rs13020237).
    results
        CSV file with system, quantity, value and, where known, sigma or low and high, distance_m,
        view, direction, remarks: a remark that names the figure makes it not certain. Or
        pfeifer2021, the paper's Tables 1 and 2.
    details
        Print a row for each figure instead of one for each system.
    """
    from mmqa_lab import io, tender

    sets = {"test": "test", "1": "scenario 1", "2": "scenario 2"}
    paper, _, name = criteria.partition(":")
    if paper == "pfeifer2021" and name in sets:
        wanted = tender.published_criteria(sets[name])
    else:
        wanted = io.read_table(criteria, "criteria")
    if results == "pfeifer2021":
        found = tender.published_results()
    else:
        found = io.read_table(results, "results")
    verdicts = tender.verdicts(wanted, found)
    return verdicts if details else tender.qualification(verdicts)
