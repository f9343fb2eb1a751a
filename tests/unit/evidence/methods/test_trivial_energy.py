"""CE as printed prefers no body at all; the work-energy balance finds the truth."""

import numpy as np

from evidence.methods.trivial_energy import sentences, trivial_energy


def test_printed_cost_falls_to_the_trivial_solution():
    found = trivial_energy("target")
    by_scale = dict(zip(found.scales, found.printed_rms_j, strict=True))
    values = [by_scale[s] for s in sorted(by_scale)]
    assert values == sorted(values)
    assert min(by_scale, key=by_scale.get) == 0.0
    assert found.printed_least[0] < 0  # without the bound of physics: a body of negative mass


def test_balance_is_least_at_the_truth():
    found = trivial_energy("target")
    by_scale = dict(zip(found.scales, found.balance_rms_j, strict=True))
    assert min(by_scale, key=by_scale.get) == 1.0
    # work by Simpson's rule at 100 Hz, energies of some J
    assert by_scale[1.0] < 1e-5
    np.testing.assert_allclose(found.balance_least[0], found.truth[0], rtol=1e-4)
    assert any("trivial" in line for line in sentences(found))
