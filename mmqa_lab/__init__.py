"""A laboratory for the quality of mobile mapping point clouds and images.

Each room is a module named by a noun of the field. Import the room that you need, as in
``from mmqa_lab import chart_cloud``. A room imports only rooms above it in this list:

- ``_data``: tables and folders that come with the package
- ``_checks``: checks of arguments, each with one sentence
- ``rotations``: rotations of vehicles and scanners, directions across an axis
- ``cloud``: the container of points and their named columns
- ``published``: what the five sources print, as data; the ledger of verdicts
- ``stats``: recall, precision, RMSE, NMAD; confidence intervals, bootstrap
- ``planes``: planes, lines and circles fitted to points; sigma_MAD
- ``plane_search``: the planes of a whole cloud
- ``spacing``: quadrant distances d1..d4, f; spacing by direction, g
- ``io``: files: LAS, LAZ, COPC, PLY, text, polygons, trajectories, segments, heights, images
- ``scan_pattern``: profile scanners: spacing, angle and density, predicted (MIMIC) and measured
- ``charts``: the test charts, to print and to measure
- ``samples``: the clouds that come with the package, and larger public ones
- ``metrics``: the metrics of the field for a planar surface, each with its source
- ``chart_cloud``: the figures of one planar surface: density, sigma_MAD, d1..d4, f, g, intervals
- ``test_field``: errors of heights and positions on a test field, and their growth with distance
- ``lines``: edges of clouds, line-segment Hausdorff distance, displacement between line sets
- ``radiometry``: radiance, reflectance, anisotropy, even blocks of images
- ``repeatability``: how far figures vary when the surface is selected again (ISO 5725)
- ``boresight``: boresight and lever arms of scan heads from drives in both directions
- ``poles``: detectors of poles, two published and one learned, and their scores
- ``chart_image``: the chart in photographs: pixel size, resolved line pairs, legibility
- ``mtf``: MTF, slanted edges, Siemens stars, bars, sharpness
- ``tender``: verdicts of a tender: criteria, margin, uncertainty
- ``image_targets``: resolution, sensor and reflectance from targets in your own images
- ``simulate``: scenes, trajectories, scanners, cameras, point patterns of known truth
- ``bench``: methods compared and ranked on cases of known truth
- ``plots``: journal figures in matplotlib: styles, widths, colours
- ``views``: 3-D views in a notebook
- ``maps``: figures in the cells of a plan; campaigns in tiles, on Dask
- ``widgets``: explorers, selection of a surface, the jury's form
- ``studies``: cases and methods of each notebook
- ``run``: runs of the studies: results, pages, students' copies
- ``commands``: the commands of ``mmqa``
"""

__all__ = ["__version__"]

__version__ = "0.5.0"
