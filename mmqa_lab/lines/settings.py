"""Constants of the search for a displacement, and what each was chosen on.

| constants | chosen on |
|---|---|
| TURN_RAD, CHANGE, USUAL_CHANGE, CHANGED_M, TURNS | drifts and turns of mobile scanners in print |
| STEP_M to AGREE, MOST_RADIUS_M, MOST_VOTES | half the noise of lines; time and memory |
| VOTE, FIRST_NOISE_M, CLUTTER_PER_M2, LEFT_M | simulated canyons of other seeds than the reported |
| ENDS_AGREE, END_M, CLUTTER_ENDS_PER_M | gaps of ends in simulated rows of windows |
| PATHS, ELSEWHERE_M | simulated canyons |
| MOST_PATHS, LEAST_VOTES | equal bays, where three paths may be all one wrong answer |
| LEAST_EVIDENCE, FEW_SHARE | canyons, and sets without any common line |
| FEW_EVIDENCE, RIVAL, MOST_RIVAL | 300 rows of windows with few common lines: no score there |
"""

import numpy as np

__all__ = [
    "AGREE", "CHANGE", "CHANGED_M", "CLUTTER_ENDS_PER_M", "CLUTTER_PER_M2", "ELSEWHERE_M",
    "ENDS_AGREE", "END_M", "FEW_EVIDENCE", "FEW_SHARE", "FINE_M", "FINE_RADIUS_M", "FIRST_NOISE_M",
    "LEAST_EVIDENCE", "LEAST_VOTES", "LEFT_M", "MOST_PATHS", "MOST_RADIUS_M", "MOST_RIVAL",
    "MOST_STATIONS", "MOST_VOTES", "PATHS", "RIVAL", "STATION_M", "STEP_M", "TURNS", "TURN_RAD",
    "USUAL_CHANGE", "VOTE",
]  # fmt: skip

# Prior standard deviation of the rotation about the vertical.
TURN_RAD = np.radians(1.0)

# Steps of the displacements tried, first and about the path found, and how far from it.
STEP_M, FINE_M, FINE_RADIUS_M = 0.3, 0.15, 1.5

# Distance of stations, their number, and the distance in steps within which lines agree.
STATION_M, MOST_STATIONS, AGREE = 5.0, 60, 1.7

# Largest radius, and number of votes at all stations that is kept in memory.
MOST_RADIUS_M, MOST_VOTES = 20.0, 3e7

# Largest change of the displacement with the distance from the middle (a turn of 3.4 degrees), its
# usual change from station to station, m/m, and its largest change in all, m.
CHANGE, USUAL_CHANGE, CHANGED_M = 0.06, 0.05, 6.0

# Turns tried between the lines on both sides of the path.
TURNS = np.radians([-3, -1.5, 0, 1.5, 3])

# Log likelihood ratio of one vote.
VOTE = 2.5

# Deviations from the path with which the pairs are sought first.
FIRST_NOISE_M = 0.3

# Density of unrelated parallel lines; standard deviation of drift that neighbours do not show.
CLUTTER_PER_M2, LEFT_M = 0.1, 0.08

# Least share of the ends of true pairs that agree and their mean gap; density of other gaps.
ENDS_AGREE, END_M, CLUTTER_ENDS_PER_M = 0.3, 0.15, 0.4

# Number of paths compared, the most where others have nearly as many votes as the best, this
# share, and the least distance of paths at each station.
PATHS, MOST_PATHS, LEAST_VOTES, ELSEWHERE_M = 3, 8, 0.75, 0.8

# Least evidence per pair; the share of the smaller set below which there is a remark.
LEAST_EVIDENCE, FEW_SHARE = 2.2, 0.4

# Least evidence per pair where few lines are paired, and how much less with their share: without
# the ends, or with them.
FEW_EVIDENCE = (7.2, 10.0), (10.0, 16.0)

# Largest evidence of a path with other pairs, as a share of the best one's: with few lines, above
# this share by the share of the lines that are paired. These and the evidence with few lines were
# chosen on 300 simulated rows of windows with few common lines, so no score there.
RIVAL, MOST_RIVAL = 0.45, 0.9
