# SPDX-License-Identifier: Apache-2.0
"""Student's t and Fisher's F, from scipy.special, which is imported when one of them is first asked for.

scipy.stats would cost each node that knows a friction model 70 MB, scipy.special 30 MB, and an idle node none.
"""

from __future__ import annotations

import functools
import math
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt


@functools.cache
def t_quantile(probability: float, freedom: float) -> float:
    """Return the quantile of Student's t; infinite freedom is the normal distribution."""
    if math.isinf(freedom):
        return NormalDist().inv_cdf(probability)
    from scipy.special import stdtrit  # noqa: PLC0415  see the module

    return float(stdtrit(freedom, probability))


def t_tail(values: npt.ArrayLike, freedom: float) -> npt.NDArray[np.float64]:
    """Return the probability that Student's t exceeds each value."""
    from scipy.special import stdtr  # noqa: PLC0415  see the module

    tail: Any = stdtr(freedom, -np.asarray(values, float))
    return np.asarray(tail, float)


def f_tail(value: float, freedom: tuple[float, float]) -> float:
    """Return the probability that F with these degrees of freedom exceeds the value."""
    from scipy.special import fdtrc  # noqa: PLC0415  see the module

    return float(fdtrc(*freedom, value))
