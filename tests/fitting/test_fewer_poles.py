"""A model whose coefficients are not known gives way to a smaller one where that makes the record likelier."""

import numpy as np

import replant as rp
from replant.signals import prbs, white_noise
from support.cases import every

U = prbs(1500, hold=8)
LAG = rp.TransferFunction([2.0], [1.0, 1.0])
TWO = rp.TransferFunction([3.0], [1.0, 2.5, 1.5])


def reasons(plant: rp.TransferFunction, poles: int, zeros: int = 0) -> tuple[str, ...]:
    y = plant.simulate(U, 0.05)
    return rp.fit(
        U, y + white_noise(U.size, 0.2 * float(np.std(y)), seed=5), 0.05, poles=poles, zeros=zeros
    ).verdict.reasons


@every(("poles", "zeros"), [(2, 0), (2, 1), (3, 0)])
def test_of_a_lag_one_pole_is_asked_for(poles: int, zeros: int) -> None:
    assert any("likelier: ask for one pole" in reason for reason in reasons(LAG, poles, zeros))


@every(("plant", "poles"), [(LAG, 1), (TWO, 2)])
def test_of_the_right_order_no_fewer_poles_are_asked_for(plant: rp.TransferFunction, poles: int) -> None:
    assert not any("fewer poles the record" in reason for reason in reasons(plant, poles))


def test_where_the_larger_model_cannot_be_trusted_it_comes_first() -> None:
    clean = LAG.simulate(U, 0.05)
    fitted = rp.fit(U, clean + white_noise(U.size, 1.5, seed=5), 0.05, poles=3, zeros=2)
    verdict = fitted.verdict
    assert np.std(fitted.transfer_function.simulate(U, 0.05) - clean) > 0.1 * np.std(clean)
    assert verdict.status != "trusted"
    assert verdict.reasons[0].startswith("with fewer poles the record is likelier")
