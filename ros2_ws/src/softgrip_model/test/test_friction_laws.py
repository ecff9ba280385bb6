# SPDX-License-Identifier: Apache-2.0
"""The laws against published values, closed forms, an independent integration and finite differences."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from softgrip_model.friction.errors import LawError
from softgrip_model.friction.laws import FrictionLaw, KReading, LambdaSign, Law, LawStatus
from softgrip_model.friction.published import TABLE_3_2, published, published_ids

#: (T2 [N], angle [deg]) of the reference values.
SETTINGS = [(1.962, 10), (1.962, 90), (5.886, 50), (9.81, 10), (9.81, 90)]
#: Rf computed by hand from Eqs 3.8 and 3.9: K as printed, K -> 0, exact, and K as printed with lambda as printed.
REFERENCE = {
    "twine-tpu": [
        (1.2274, 1.2269, 1.2264, 1.3167),
        (2.1133, 2.0394, 1.9781, 2.2670),
        (1.4122, 1.4027, 1.3939, 1.6987),
        (1.1088, 1.1086, 1.1084, 1.4067),
        (1.6307, 1.6013, 1.5754, 2.0687),
    ],
    "twine-pla": [
        (1.2040, 1.2035, 1.2030, 1.2631),
        (1.8840, 1.8201, 1.7684, 1.9766),
        (1.3335, 1.3264, 1.3199, 1.5129),
        (1.1150, 1.1148, 1.1146, 1.3118),
        (1.4642, 1.4452, 1.4284, 1.7227),
    ],
    "braid-tpu": [
        (1.1775, 1.1774, 1.1772, 1.2638),
        (1.5292, 1.5130, 1.4984, 1.6414),
        (1.2147, 1.2125, 1.2103, 1.4632),
        (1.0706, 1.0706, 1.0705, 1.3607),
        (1.2701, 1.2643, 1.2588, 1.6142),
    ],
    "braid-pla": [
        (1.1276, 1.1274, 1.1272, 1.1981),
        (1.4166, 1.3949, 1.3766, 1.5052),
        (1.1304, 1.1287, 1.1271, 1.3259),
        (1.0334, 1.0334, 1.0333, 1.2692),
        (1.1409, 1.1374, 1.1343, 1.4011),
    ],
}
READINGS = (KReading.PRINTED, KReading.LIMIT, KReading.EXACT)


def rounded(law: FrictionLaw, settings=SETTINGS):
    return [round(float(law.ratio(np.radians(angle), tension)), 4) for tension, angle in settings]


@pytest.mark.parametrize("pair", sorted(REFERENCE))
@pytest.mark.parametrize("column", range(3), ids=READINGS)
def test_published_pairs_give_the_reference_ratios(pair, column):
    law = dataclasses.replace(published(pair).law, k_reading=READINGS[column])
    assert rounded(law) == [row[column] for row in REFERENCE[pair]]


@pytest.mark.parametrize("pair", sorted(REFERENCE))
def test_lambda_as_printed_is_a_named_option(pair):
    law = published(pair, LambdaSign.PRINTED).law
    assert law.by_name["lambda"] < 0
    assert rounded(law) == [row[3] for row in REFERENCE[pair]]


def test_heap_and_chapter_4_reference_ratios():
    heap = [(1.962, 10), (1.962, 90), (5.886, 50), (9.81, 90)]
    assert rounded(published("twine-tpu-heap").law, heap) == [1.0939, 2.4567, 1.4129, 1.7466]
    chapter_4 = [(1.962, 10), (1.962, 90), (5.886, 50), (9.81, 90), (20.0, 45)]
    assert rounded(published("braid-tpu-chapter4").law, chapter_4) == [1.1170, 1.7183, 1.3028, 1.4957, 1.2137]


@pytest.mark.parametrize(
    ("pair", "at_1_962", "at_0_1"),
    [
        ("twine-tpu", 783, 431),
        ("twine-pla", 668, 282),
        ("braid-tpu", 1249, 584),
        ("braid-pla", 759, 174),
        ("braid-tpu-chapter4", 1085, 635),
    ],
)
def test_blow_up_angle(pair, at_1_962, at_0_1):
    law = published(pair).law
    assert round(np.degrees(law.blow_up_angle(1.962))) == at_1_962
    assert round(np.degrees(law.blow_up_angle(0.1))) == at_0_1


@pytest.mark.parametrize(
    ("pair", "newtons"), [("twine-tpu", 29.37), ("twine-pla", 83.44), ("braid-tpu", 24.21), ("braid-pla", 15.59)]
)
def test_surface_term_vanishes_where_it_should(pair, newtons):
    law = published(pair).law
    assert law.vanishing_tension == pytest.approx(newtons, abs=0.005)
    below, above = law.evaluate(0.0, [0.99 * newtons, 1.01 * newtons]).status
    assert not below & LawStatus.SURFACE_CLAMPED
    assert above & LawStatus.SURFACE_CLAMPED
    assert float(law.ratio(0.0, 2 * newtons)) == 1.0


def test_friction_falls_with_tension_for_all_pairs():
    tensions = 9.81 * np.array([0.2, 0.4, 0.6, 0.8, 1.0])
    angles = np.radians(np.arange(0, 91, 10))
    for pair in TABLE_3_2:
        ratio = published(pair).ratio(angles[:, np.newaxis], tensions)
        assert (np.diff(ratio, axis=1) < 0).all()
        assert (ratio[0] > 1).all()


# -- closed forms against an independent integration -------------------------------------------------------------------


def integrated(alpha, n, radius_mm, angle, start):
    """Integrate dT/dtheta = alpha r^(1-n) T^n from ``start`` over ``angle`` (negative: backwards)."""
    solution = solve_ivp(lambda _, t: alpha * radius_mm ** (1 - n) * t**n, (0, angle), [start], rtol=1e-11, atol=1e-12)
    return solution.y[0, -1]


@pytest.mark.parametrize(("alpha", "n", "radius"), [(0.3195, 0.799, 3.75), (0.1211, 0.5047, 3.125)])
@pytest.mark.parametrize(("low", "angle"), [(1.962, 1.5), (9.81, 0.4), (0.2, 2.5)])
def test_exact_reading_is_the_integral_from_the_low_tension(alpha, n, radius, low, angle):
    law = FrictionLaw(Law.HEAP, (alpha, n), radius, KReading.EXACT)
    assert float(law.ratio(angle, low)) == pytest.approx(integrated(alpha, n, radius, angle, low) / low, rel=1e-8)


@pytest.mark.parametrize(("alpha", "n", "radius"), [(0.3195, 0.799, 3.75), (0.1211, 0.5047, 3.125)])
def test_printed_reading_is_that_integral_only_if_its_tension_is_the_high_one(alpha, n, radius):
    high, angle = 5.0, 1.2
    law = FrictionLaw(Law.HEAP, (alpha, n), radius, KReading.PRINTED)
    low = integrated(alpha, n, radius, -angle, high)
    assert float(law.ratio(angle, high)) == pytest.approx(high / low, rel=1e-8)


@given(
    alpha=st.floats(0.01, 1.0),
    n=st.floats(0.05, 0.95),
    radius=st.floats(0.5, 10.0),
    angle=st.floats(0.0, 3.0),
    tension=st.floats(0.05, 50.0),
)
def test_readings_are_ordered_and_meet_at_small_angles(alpha, n, radius, angle, tension):
    printed, limit, exact = (
        FrictionLaw(Law.HEAP, (alpha, n), radius, reading).evaluate(angle, tension).log_ratio for reading in READINGS
    )
    if np.isfinite(printed):
        assert printed >= limit * (1 - 1e-12)
    assert exact <= limit * (1 + 1e-12)
    tiny = [
        float(FrictionLaw(Law.HEAP, (alpha, n), radius, reading).evaluate(1e-9, tension).log_ratio)
        for reading in READINGS
    ]
    assert tiny[0] == pytest.approx(tiny[1], rel=1e-6)
    assert tiny[2] == pytest.approx(tiny[1], rel=1e-6)


@given(angle=st.floats(0.0, 3.0), tension=st.floats(0.05, 50.0), alpha=st.floats(0.05, 1.0))
def test_n_to_one_is_capstan(angle, tension, alpha):
    capstan = float(FrictionLaw(Law.CAPSTAN, (alpha,), 3.0).ratio(angle, tension))
    for reading in READINGS:
        heap = FrictionLaw(Law.HEAP, (alpha, 1 - 1e-9), 3.0, reading)
        assert float(heap.ratio(angle, tension)) == pytest.approx(capstan, rel=1e-6)


@given(angle=st.floats(0.0, 3.0), tension=st.floats(0.05, 50.0))
def test_matte_without_surface_is_heap(angle, tension):
    heap = FrictionLaw(Law.HEAP, (0.3, 0.7), 3.0)
    matte = FrictionLaw(Law.MATTE, (0.3, 0.7, 0.0, 0.0), 3.0)
    assert float(matte.ratio(angle, tension)) == float(heap.ratio(angle, tension))


@given(first=st.floats(0.0, 1.2), second=st.floats(0.0, 1.2), low=st.floats(0.1, 20.0))
def test_two_wraps_of_the_exact_law_are_one(first, second, low):
    law = FrictionLaw(Law.HEAP, (0.3, 0.6), 3.0, KReading.EXACT)
    between = low * float(law.ratio(first, low))
    high = between * float(law.ratio(second, between))
    assert low * float(law.ratio(first + second, low)) == pytest.approx(high, rel=1e-10)


# -- derivatives -------------------------------------------------------------------------------------------------------


@given(
    law=st.sampled_from(list(Law)),
    reading=st.sampled_from(READINGS),
    alpha=st.floats(0.05, 0.6),
    n=st.floats(0.1, 0.97),
    epsilon=st.floats(0.05, 0.3),
    lam=st.floats(-0.1, 0.02),
    angle=st.floats(0.01, 2.0),
    tension=st.floats(0.5, 20.0),
)
def test_derivatives_agree_with_finite_differences(law, reading, alpha, n, epsilon, lam, angle, tension):
    coefficients = {Law.CAPSTAN: (alpha,), Law.HEAP: (alpha, n), Law.MATTE: (alpha, n, epsilon, lam)}[law]
    model = FrictionLaw(law, coefficients, 3.125, reading)
    value = model.evaluate(angle, tension)
    if value.status or (law is Law.MATTE and epsilon - lam * np.log(tension) < 1e-3):
        return
    if not np.isfinite(model.evaluate(angle * 1.01, tension * 0.99).log_ratio):
        return

    def slope(function, at, step):
        return (function(at + step) - function(at - step)) / (2 * step)

    def log_ratio(a=angle, t=tension, c=coefficients):
        return float(model.with_coefficients(c).evaluate(a, t).log_ratio)

    assert float(value.d_angle) == pytest.approx(slope(lambda a: log_ratio(a=a), angle, 1e-6), rel=1e-5, abs=1e-7)
    log_t = np.log(tension)
    by_tension = slope(lambda u: log_ratio(t=np.exp(u)), log_t, 1e-6)
    assert float(value.d_log_tension) == pytest.approx(by_tension, rel=1e-5, abs=1e-7)
    for i in range(len(coefficients)):

        def moved(c, i=i):
            return log_ratio(c=(*coefficients[:i], c, *coefficients[i + 1 :]))

        numeric = slope(moved, coefficients[i], 1e-6)
        assert float(value.d_coefficients[i]) == pytest.approx(numeric, rel=1e-5, abs=1e-7)


def test_derivatives_are_regular_where_k_vanishes():
    law = FrictionLaw(Law.HEAP, (0.3, 1 - 1e-7), 3.0)
    value = law.evaluate(1.0, 2.0)
    # n -> 1: ln Rf = alpha (r/T)^(1-n) theta, so d/dn = -alpha theta ln(r/T) up to O(alpha^2 theta^2).
    expected = -(0.3 * np.log(3.0 / 2.0) - 0.5 * 0.3**2 * -1.0)
    assert float(value.d_coefficients[1]) == pytest.approx(expected, rel=1e-5)
    assert (law.evaluate(0.0, 2.0).d_coefficients == 0.0).all()


# -- domain ------------------------------------------------------------------------------------------------------------


def test_values_outside_the_calibrated_range_are_given_and_flagged():
    law = published("braid-tpu").law
    inside, angle, tension, both = law.evaluate(np.radians([50, 100, 50, 5]), [5.0, 5.0, 12.0, 1.0]).status
    assert inside == LawStatus.OK
    assert angle == LawStatus.ANGLE_OUTSIDE_RANGE
    assert tension == LawStatus.TENSION_OUTSIDE_RANGE
    assert both == LawStatus.ANGLE_OUTSIDE_RANGE | LawStatus.TENSION_OUTSIDE_RANGE
    assert np.isfinite(law.ratio(np.radians(100), 12.0))


def test_no_value_past_the_blow_up_angle():
    law = published("twine-pla").law
    angle = law.blow_up_angle(0.1)
    value = law.evaluate([0.999 * angle, 1.001 * angle], 0.1)
    assert np.isfinite(value.log_ratio[0])
    assert np.isnan(value.log_ratio[1])
    assert np.isnan(value.d_coefficients[1]).all()
    assert value.status[1] & LawStatus.BLOW_UP
    limit = dataclasses.replace(law, k_reading=KReading.LIMIT)
    assert np.isinf(limit.blow_up_angle(0.1))
    assert np.isfinite(limit.ratio(1.001 * angle, 0.1))


def test_tensions_below_the_floor_count_as_the_floor_and_are_flagged():
    law = published("braid-tpu").law
    value = law.evaluate(1.0, [0.0, 1e-3, 1e-2])
    assert value.log_ratio[0] == value.log_ratio[1] == value.log_ratio[2]
    assert list(value.status & LawStatus.TENSION_FLOORED) == [LawStatus.TENSION_FLOORED, LawStatus.TENSION_FLOORED, 0]
    assert value.d_log_tension[0] == 0.0


@pytest.mark.parametrize(("angle", "tension"), [(-0.1, 1.0), (np.nan, 1.0), (1.0, np.nan), (1.0, -1.0), (np.inf, 1.0)])
def test_impossible_input_has_no_value(angle, tension):
    value = published("braid-tpu").law.evaluate(angle, tension)
    assert np.isnan(value.log_ratio)
    assert value.status & LawStatus.INVALID


@pytest.mark.parametrize(
    ("law", "coefficients", "radius", "found"),
    [
        (Law.MATTE, (0.3, 1.0, 0.1, 0.0), 3.0, "n = 1"),
        (Law.HEAP, (0.3, 0.0), 3.0, "n = 0"),
        (Law.MATTE, (0.3, 0.5, 0.1), 3.0, "found 3"),
        (Law.HEAP, (np.nan, 0.5), 3.0, "alpha"),
        (Law.HEAP, (0.3, 0.5), 0.0, "0 mm"),
    ],
)
def test_impossible_laws_are_refused(law, coefficients, radius, found):
    with pytest.raises(LawError, match=found):
        FrictionLaw(law, coefficients, radius)


def test_shapes_broadcast():
    law = published("braid-tpu").law
    value = law.evaluate(np.zeros((3, 1)), np.ones(4))
    assert value.log_ratio.shape == value.status.shape == (3, 4)
    assert value.d_coefficients.shape == (3, 4, 4)
    assert law.evaluate(0.5, 2.0).log_ratio.shape == ()


def test_every_published_model_says_where_it_stands():
    assert set(TABLE_3_2) < set(published_ids())
    for model_id in published_ids():
        model = published(model_id)
        assert model.id == model_id
        assert "Table 3" in model.source or "section" in model.source
        assert model.covariance is None
