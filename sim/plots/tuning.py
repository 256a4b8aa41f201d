"""The figure of a tuning: the metric over each parameter, with its importance."""

from __future__ import annotations

from pathlib import Path

from swarmd.sim.experiments.tune import Tuning, quiet_optuna
from swarmd.sim.plots.select import Quantity, label_of
from swarmd.sim.plots.theme import save


def draw_landscape(tuning: Tuning, path: Path) -> Path:
    """Draw optuna's slice plot of the mean of each candidate, a panel a parameter; returns `path`.

    The colour has the number of the candidate; the present values are the palest point, unless they
    are outside of the search space. The mean of a candidate that ended early is extrapolated. A
    verb draws it: matplotlib then has the backend Agg, which opens no window.
    """
    import matplotlib
    from matplotlib import pyplot
    from optuna import create_study
    from optuna.distributions import CategoricalDistribution
    from optuna.trial import create_trial
    from optuna.visualization.matplotlib import plot_slice

    matplotlib.use("agg")
    labels = {}
    distributions = {}
    for one in tuning.space.parameters:
        share = tuning.importance.get(one.key)
        importance = "" if share is None else f"\nimportance {share:.0%}"
        labels[one.name] = f"{Quantity(one.name, one.unit)}{importance}"
        choices = CategoricalDistribution(one.choices) if one.choices else None
        distributions[labels[one.name]] = choices or one.distribution()
    metric = Quantity(label_of(tuning.metric.name), tuning.metric.unit)
    with quiet_optuna(), matplotlib.rc_context({"figure.constrained_layout.use": True}):
        study = create_study()
        for candidate in sorted(tuning.candidates, key=lambda one: one.number):
            values = {labels[name]: value for name, value in candidate.values.items()}
            used = distributions if values else {}  # present values may be out of range
            trial = create_trial(params=values, distributions=used, value=tuning.value(candidate))
            study.add_trial(trial)
        plot_slice(study, target_name=str(metric))
        figure = pyplot.gcf()
        pyplot.close(figure)  # pyplot forgets it
        return save(figure, path)
