"""What a digital camera's numbers mean: radiance, reflectance, even blocks, and resolution.

EuroSDR 2013, image radiometry (project "Radiometric aspects of digital photogrammetric images",
2008-2011, Honkavaara et al.). Its rooms follow the report's steps:

=============== ==============================================================================
``sensor``      DN to radiance: gain, offset, exposure, saturation, stability (equations 1-3)
``reflectance`` reflectance (4), empirical line, errors (6-8), NDVI
``brdf``        Walthall's function (5) and the anisotropy factor
``block``       one radiometric adjustment of overlapping images: radiometric aerial triangulation
``edge``        edge spread function as a sigmoid: FWHM, MTF50
``siemens``     Siemens stars: contrast per radius, MTF, point spread function
``bars``        resolving power from line bars
``sharpness``   local sharpness by Haar wavelets; where in the image resolution is lost
=============== ==============================================================================

Equation numbers are the report's; the notation is this package's.
"""
