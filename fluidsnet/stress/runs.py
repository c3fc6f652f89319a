"""Run cases by a model and its prior."""

from __future__ import annotations

from collections.abc import Callable

from fluidsnet.features import NoGlobalFeature
from fluidsnet.integrator import Displacement
from fluidsnet.model import Model
from fluidsnet.stress.cases import Case
from fluidsnet.stress.outcome import Outcome, judge, model_states, says_of
from fluidsnet.target import PriorAlone


def prior_of(model: Model) -> Model | None:
    """Return the prior of a network alone; None where it is no solver or the model itself."""
    if not model.network.target.width or not model.prior.describes:
        return None
    return Model(
        (1, 1, 1),
        prior=model.prior,
        target=PriorAlone(),
        integrator=Displacement(),
        global_feature=NoGlobalFeature,
        dimension=model.network.dimension,
    ).eval()


def run_case(case: Case, model: Model, advance: Callable[[], None]) -> dict[str, Outcome]:
    """Return the outcomes of a case for "model" and, if a network corrects one, "prior".

    Args:
        case: Case.
        model: Model in evaluation mode, on the CPU.
        advance: Called after each step.
    """
    start, found = case.make(), {}
    for name, one in (("model", model), ("prior", prior_of(model))):
        if one is not None:
            states = model_states(one, start, case.steps, advance)
            at_use = says_of(one, start) if name == "model" else ""
            found[name] = judge(start, states, case.steps, case.closed, at_use)
    return found
