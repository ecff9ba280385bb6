# SPDX-License-Identifier: Apache-2.0
"""Where materials stop being known: Drucker's limits of the published constants, ranges in tension and compression."""

import numpy as np
import pytest
from scipy.optimize import brentq

from softgrip_model.gdfe import ConstitutiveLaw, Linear, Mesh, Solver, SolverSettings, Supports, VolumeShape, bar
from softgrip_model.gdfe.materials import cheetah_ogden, neo_hookean, ninjaflex, ninjaflex_ogden
from softgrip_model.gdfe.validity import law_error, principal_stretches, warnings_of


def uniaxial(l):  # noqa: E741  lambda of the equations
    return np.array([l, l**-0.5, l**-0.5])


def equibiaxial(l):  # noqa: E741
    return np.array([l, l, l**-2.0])


def planar(l):  # noqa: E741
    return np.array([l, 1.0, 1.0 / l])


def min_tangent(material, stretches):
    """Least stiffness against a change of shape, by finite differences of the Kirchhoff stress."""

    def stress(log_stretch):
        return sum(
            2 * mu / a * np.exp(a * log_stretch) for mu, a in zip(material.moduli, material.exponents, strict=True)
        )

    at, h = np.log(stretches), 1e-6
    changes = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0]])
    slope = np.array([(stress(at + h * c) - stress(at - h * c)) / (2 * h) for c in changes]) @ changes.T
    return np.linalg.eigvalsh(0.5 * (slope + slope.T))[0]


# limits that docs/gdfe.md states for Table 5.1
@pytest.mark.parametrize(
    ("mode", "inside", "limit"),
    [(uniaxial, 0.8, 0.69), (equibiaxial, 1.1, 1.205), (planar, 1.3, 1.525), (planar, 0.8, 0.655)],
)
def test_cheetah_is_stable_up_to_its_limit(mode, inside, limit):
    material = cheetah_ogden()
    at = brentq(lambda s: min_tangent(material, mode(s)), inside, limit + 0.1 * (limit - inside))
    assert at == pytest.approx(limit, abs=0.006)
    outward = np.sign(limit - inside)
    assert material.stable(mode(at - 1e-4 * outward))
    assert not material.stable(mode(at + 1e-4 * outward))


@pytest.mark.parametrize("mode", [uniaxial, equibiaxial, planar])
def test_ninjaflex_is_stable_throughout(mode):
    stretches = np.array([mode(s) for s in np.linspace(0.2, 5.0, 97)])
    assert ninjaflex_ogden().stable(stretches).all()
    assert cheetah_ogden().stable(np.array([uniaxial(s) for s in np.linspace(1.0, 5.0, 41)])).all()


def moved(stretches):
    mesh = bar((2.0, 1.0, 1.0), (2, 1, 1), 2)
    return mesh, mesh.nodes * (np.array(stretches) - 1.0)


def test_principal_stretches_are_those_of_the_motion():
    mesh, displacement = moved((1.3, 0.9, 0.8))
    np.testing.assert_allclose(principal_stretches(mesh, displacement), [[1.3, 0.9, 0.8]] * 2, atol=1e-12)


@pytest.mark.parametrize(
    ("stretches", "words"),
    [
        ((1.2, 0.9, 0.9), []),
        ((3.5, 0.8, 0.8), ["NinjaFlex: stretched to a strain of 2.50"]),
        ((1.0, 0.6, 1.2), ["NinjaFlex: compressed to a strain of -0.40"]),
    ],
)
def test_a_polynomial_warns_on_both_sides_of_its_range(stretches, words):
    mesh, displacement = moved(stretches)
    found = warnings_of(mesh, [ninjaflex(), Linear("any", 1.0, 0.3)], displacement)
    assert len(found) == len(words)
    assert all(text.startswith(word) for text, word in zip(found, words, strict=True))


def test_an_ogden_material_warns_where_it_is_unstable():
    mesh, displacement = moved((1.25, 1.25, 0.64))
    found = warnings_of(mesh, [neo_hookean("rubber", 1.0, 0.45), cheetah_ogden()], displacement)
    assert any(text.startswith("Cheetah: not stable (Drucker) in 1 elements, as in element 1") for text in found)
    assert not any(text.startswith("rubber: not stable") for text in found)


@pytest.mark.parametrize("shape", list(VolumeShape))
@pytest.mark.parametrize(("mode", "stretch"), [(uniaxial, 1.5), (planar, 1.1), (equibiaxial, 1.1), (uniaxial, 0.9)])
def test_the_calibrated_laws_error_is_that_of_its_stress(mode, stretch, shape):
    """Against forces of both laws on one element, whose deviators are compared here by hand."""
    material = cheetah_ogden(0.45)
    mesh, displacement = moved(mode(stretch))
    everywhere = np.arange(len(mesh.nodes), dtype=np.int32)
    deviators = []
    for law in (ConstitutiveLaw.CALIBRATED, ConstitutiveLaw.RIGOROUS):
        supports = Supports.none(len(mesh.nodes)).with_prescribed(everywhere)
        settings = SolverSettings(law=law, volume_shape=shape)
        solver = Solver(Mesh(mesh.nodes, mesh.hexes, np.zeros(2)), [material], supports, settings=settings)
        force = solver.internal_force(displacement)
        nominal = [force[at == at.max(), axis].sum() for axis, at in enumerate(mesh.nodes.T)] / np.array(
            [1.0, 2.0, 2.0]
        )
        kirchhoff = nominal * mode(stretch)
        deviators.append(kirchhoff - kirchhoff.mean())
    calibrated, rigorous = deviators
    expected = np.linalg.norm(calibrated - rigorous) / np.linalg.norm(rigorous)
    assert law_error(material, mode(stretch)[None], shape)[0] == pytest.approx(expected, rel=1e-3)


def test_the_calibrated_law_says_where_the_rigorous_one_is_needed():
    material = ninjaflex_ogden(0.45)
    mesh, drawn = moved(uniaxial(1.4))
    assert not warnings_of(mesh, [material, material], drawn)
    mesh, spread = moved(equibiaxial(1.2))
    (text, _) = warnings_of(mesh, [material, material], spread)
    assert "off by 51 % of the stress" in text
    assert "take the law 'rigorous'" in text
    assert not warnings_of(mesh, [material, material], spread, ConstitutiveLaw.RIGOROUS)
