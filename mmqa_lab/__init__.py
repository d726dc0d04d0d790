"""A laboratory for the quality of mobile mapping point clouds and images.

Each room is a module named by a noun of the field. Import the room that you need, as in
``from mmqa_lab import chart_cloud``.

Measures of clouds:

- ``chart_cloud``: the figures of one planar surface: density, sigma_MAD, d1..d4, f, g, intervals
- ``metrics``: the metrics of the field for a planar surface, each with its source
- ``spacing``: quadrant distances d1..d4, f; spacing by direction, g; empty space
- ``planes``: planes, lines and circles fitted to points; sigma_MAD
- ``plane_search``: the planes of a whole cloud
- ``scan_pattern``: profile scanners: spacing, angle and density, predicted (MIMIC) and measured
- ``repeatability``: how far figures vary when the surface is selected again (ISO 5725)
- ``maps``: figures in the cells of a plan; campaigns in tiles, on Dask

Measures of lines and of poles:

- ``lines``: edges of clouds, line-segment Hausdorff distance, displacement between line sets
- ``poles``: detectors of poles, two published and one learned, and their scores

Measures of images:

- ``charts``: the test charts, to print and to measure
- ``chart_image``: the chart in photographs: pixel size, resolved line pairs, legibility
- ``mtf``: edges, Siemens stars, bars, sharpness
- ``radiometry``: radiance, reflectance, anisotropy, even blocks of images
- ``image_targets``: resolution, sensor and reflectance from targets in your own images

Accuracy and verdicts:

- ``stats``: rates and errors: recall, RMSE, NMAD; confidence intervals, bootstrap
- ``test_field``: errors of heights and positions on a test field, and their growth with distance
- ``boresight``: boresight and lever arms of scan heads from drives in both directions
- ``tender``: verdicts of a tender: criteria, margin, uncertainty

Simulators:

- ``simulate``: scenes, trajectories, scanners, cameras, point patterns of known truth

The laboratory:

- ``bench``: methods compared and ranked on cases of known truth
- ``published``: what the five sources print, as data; the ledger of verdicts
- ``studies``: cases and methods of each notebook
- ``run``: runs of the studies: results, pages, students' copies

Showing:

- ``plots``: journal figures in matplotlib: styles, widths, colours
- ``views``: 3-D views in a notebook
- ``widgets``: explorers, selection of a surface, the jury's form

Files, and what all share:

- ``cloud``: the container of points and their named columns
- ``io``: files: LAS, LAZ, COPC, PLY, text, polygons, trajectories, segments, heights, images
- ``samples``: the clouds that come with the package, and larger public ones
- ``commands``: the commands of ``mmqa``
- ``rotations``: rotations of vehicles and scanners, directions across an axis
- ``_checks``: checks of arguments, each with one sentence
- ``_data``: tables and folders that come with the package
"""

__all__ = ["__version__"]

__version__ = "0.5.0"
