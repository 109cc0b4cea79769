"""The quantiles of the chi-square distribution, without the second that importing `scipy.stats` takes."""

from __future__ import annotations


def chi2_quantile(probability: float, degrees: int) -> float:
    r"""Return the value that a chi-square variable exceeds with 1 - ``probability``.

    With :math:`P` the regularized lower incomplete gamma function, :math:`P(\nu / 2, x / 2) = p`.

    Examples
    --------
    >>> round(chi2_quantile(0.99, 25), 2)
    44.31
    """
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(degrees / 2.0, probability))
