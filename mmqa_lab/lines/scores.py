"""How well proposed pairs of segments agree with the true ones."""

from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd


@dataclass(frozen=True)
class PairingScores:
    """Counts over all p x q cells and the rates that follow from them.

    Parameters
    ----------
    tp, fp, fn, tn : int
        True and false, positives and negatives.

    Examples
    --------
    >>> scores = PairingScores(tp=8, fp=2, fn=2, tn=88)
    >>> scores.precision, scores.recall, scores.detection_rate, scores.null_rate
    (0.8, 0.8, 0.96, 0.9)
    """

    tp: int
    fp: int
    fn: int
    tn: int

    @property
    def detection_rate(self):
        """(TP + TN) / (p q), the paper's rate, as a share; near 1 whatever is paired."""
        return _ratio(self.tp + self.tn, self._cells)

    @property
    def null_rate(self):
        """The detection rate of pairing nothing at all."""
        return _ratio(self.tn + self.fp, self._cells)

    @property
    def precision(self):
        """Share of the proposed pairs that are true; NaN when none is proposed."""
        return _ratio(self.tp, self.tp + self.fp)

    @property
    def recall(self):
        """Share of the true pairs that are proposed; NaN when there is none."""
        return _ratio(self.tp, self.tp + self.fn)

    @property
    def f1(self):
        """Harmonic mean of precision and recall."""
        return _ratio(2 * self.tp, 2 * self.tp + self.fp + self.fn)

    @property
    def mcc(self):
        """Matthews correlation coefficient: 0 for chance, 1 for perfect; NaN when undefined."""
        margins = [self.tp + self.fp, self.tp + self.fn, self.tn + self.fp, self.tn + self.fn]
        product = float(np.prod([float(margin) for margin in margins]))
        covariance = self.tp * self.tn - self.fp * self.fn
        return covariance / product**0.5 if product else np.nan

    @property
    def _cells(self):
        return self.tp + self.fp + self.fn + self.tn

    def to_frame(self):
        """Return one row with the counts and the rates."""
        rates = ("detection_rate", "null_rate", "precision", "recall", "f1", "mcc")
        return pd.DataFrame([asdict(self) | {name: getattr(self, name) for name in rates}])


def pairing_scores(pairs, truth):
    """Score proposed pairs against true ones, cell by cell.

    Parameters
    ----------
    pairs, truth : array_like of bool, shape (p, q)
        Test segments in rows, model segments in columns.

    Returns
    -------
    PairingScores

    Raises
    ------
    TypeError, ValueError
        If they are not Boolean or their shapes differ.

    Notes
    -----
    With p q cells and some tens of pairs nearly all cells are true negatives: pairing nothing has a
    detection rate of 97.8 to 99.1 % on the paper's tables. Look at F1.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3.1: detection rate.

    Examples
    --------
    >>> scores = pairing_scores([[True, True, False]], [[True, False, False]])
    >>> scores.tp, scores.fp, scores.fn, scores.tn, scores.precision, round(scores.null_rate, 3)
    (1, 1, 0, 1, 0.5, 0.667)
    """
    pairs, truth = np.asarray(pairs), np.asarray(truth)
    for name, values in (("pairs", pairs), ("truth", truth)):
        if values.dtype != bool:
            raise TypeError(f"Invalid {name} of type {values.dtype}. Must be Boolean.")
    if pairs.shape != truth.shape:
        raise ValueError(f"Invalid pairs of shape {pairs.shape}. Must be {truth.shape} as truth.")
    tp, fp = int((pairs & truth).sum()), int((pairs & ~truth).sum())
    fn = int((~pairs & truth).sum())
    return PairingScores(tp, fp, fn, pairs.size - tp - fp - fn)


def scores_from_counts(*, p, q, pairs, fn, fp):
    """Scores of a table that prints p, q, the number of true pairs, FN and FP.

    Parameters
    ----------
    p, q : int
        Segments of either set.
    pairs : int
        True pairs.
    fn, fp : int
        Missed and wrong pairs.

    Returns
    -------
    PairingScores

    Examples
    --------
    >>> round(scores_from_counts(p=41, q=64, pairs=24, fn=2, fp=9).detection_rate * 100, 2)
    99.58
    """
    tp = pairs - fn
    return PairingScores(tp, fp, fn, p * q - tp - fp - fn)


def _ratio(part, whole):
    return part / whole if whole else np.nan
