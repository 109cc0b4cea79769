"""One run of the actuator experiment, spelled out with the article's numbers."""

import replant as rp

TRUE = {"a2": 3.292, "a1": 5891.0, "a0": 595.7, "b1": 51.47, "b0": 7.722}  # Table 6
DT = 1e-3


def trace_by_hand(record, method, variant, filters):
    """Run one configuration, spelled out in section 4.1's numbers; return identifier and trace."""
    gain = {"no buffer": 1.0, "small gain": 0.5, "very small gain": 0.1}[variant]
    optimizer = {
        "Gradient": rp.Gradient(gain=0.05 * gain),
        "IntegralCost": rp.IntegralCost(gain=0.05 * gain, forgetting_rate=0.1),
        "AMSGrad": rp.AMSGrad(step_size=0.00005 * gain),
        "Adam": rp.Adam(step_size=0.00005 * gain),
    }[method]
    ident = rp.Identifier(
        rp.Structure(poles=3, zeros=1, bias=True),
        dt=DT,
        filter=rp.StateVariableFilter(denominator=[1.0, 150.0, 7500.0, 125000.0], method=filters),
        # the printed list is that of b1, b0, a2, a1, a0; the regressor's constant of 0.1 is a sigma of 10
        scaling=rp.Scaling(0.05, [1e-4, 1e-6, 1e-6, 1e-4, 1e-4, 10.0]),
        optimizer=optimizer,
        replay=None if variant == "no buffer" else rp.Replay(capacity=240_000, batch_size=10, warmup=20, seed=0),
        preprocess=rp.Preprocess("square", input_offset=16.0, output_offset=1.5),
    )
    return ident, ident.update_many(record.u, record.y)
