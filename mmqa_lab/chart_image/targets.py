"""The coded targets of charts in an image, decoded by OpenCV, and which chart each belongs to."""

import cv2
import numpy as np

from mmqa_lab.chart_image.maps import ChartMap

__all__ = ["ENLARGED_PIXELS", "by_chart", "decoded"]

ENLARGEMENTS, ENLARGED_PIXELS = (1, 2, 4), 4e6
"""Factors of enlargement for small targets, and the number of pixels up to which they are used."""


def decoded(grey, markers, smaller):
    """Numbers and corners of the coded targets that are seen in an image made smaller."""
    dictionaries = sorted({one.dictionary for one in markers.values()})
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    best = []
    for times in ENLARGEMENTS if grey.size <= ENLARGED_PIXELS else (smaller,):
        way = cv2.INTER_CUBIC if times > 1 else cv2.INTER_AREA
        large = cv2.resize(grey, None, fx=times, fy=times, interpolation=way)
        # targets of less than 6 px a side cannot be decoded, their contours would cost time
        settings.minMarkerPerimeterRate = 24 * times / max(large.shape)
        ours = []
        for name in dictionaries:
            book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
            corners, numbers, _ = cv2.aruco.ArucoDetector(book, settings).detectMarkers(large)
            places = [(seen.reshape(4, 2).astype(float) + 0.5) / times - 0.5 for seen in corners]
            keys = [] if numbers is None else [(name, one) for one in np.ravel(numbers).tolist()]
            ours += [one for one in zip(keys, places, strict=True) if one[0] in markers]
        # a mirrored square is none of the chart's targets
        found = [one for one in ours if np.linalg.det(one[1][1:3] - one[1][:2]) > 0]
        best = max(best, found, key=len)
        # a fifth target is one of another chart, whose others are smaller
        if best and len(best) % len(markers) == 0:
            break
    return best


def by_chart(found, markers, layout):
    """The targets of each chart, the largest chart first: each says where the middle should be."""
    groups = []
    for key, corners in found:
        one = ChartMap.from_points(markers[key].corners()[::-1], corners)
        middle = one.pixels([[layout.width / 2, layout.height / 2]])[0]
        side = np.linalg.norm(corners[0] - corners[2]) / markers[key].size * layout.width
        for place, _, group in groups:
            if np.linalg.norm(place - middle) < side / 3 and key not in dict(group):
                group.append((key, corners))
                break
        else:
            groups.append((middle, side, [(key, corners)]))
    return [one[2] for one in sorted(groups, key=lambda one: (-min(len(one[2]), 3), -one[1]))]
