"""A diagnosis as text on a terminal."""

from __future__ import annotations

from flora_lab.diagnose import controllers_told, learned_told
from flora_lab.diagnose.diagnosis import Gain
from flora_lab.diagnose.residual_words import percent_sure
from flora_lab.diagnose.summary import title
from flora_lab.diagnose.work import Result


def text(result: Result) -> str:
    """Verdict, causes, gain, what comes next."""
    found = result.diagnosis
    lines = [f"verdict: {found.verdict.replace('_', ' ')}", found.summary, ""]
    for cause in found.causes:
        lines.append(f"{title(cause.effect)}: sure to {percent_sure(cause.confidence)}")
        for name, value in cause.parameters.items():
            low, high = cause.interval[name]
            lines.append(f"  {name:<18}{value:>9.3g}   90 %: {low:.3g} to {high:.3g}")
        lines += [f"  {cause.evidence}", ""]
    if found.residuals.left:
        lines += [found.residuals.left, ""]
    lines += learned_told.lines(found.learned)
    lines += _gain(found.gain)
    lines += controllers_told.lines(found.gain.controller_fitness)
    if found.next_experiment.why:
        lines += [f"next: {found.next_experiment.why}", ""]
    lines += [f"record: {note}" for note in found.record]
    return "\n".join(lines) + "\n"


def _gain(gain: Gain) -> list[str]:
    if not gain.free_running:
        return []
    names = [name for name in ("base", "extended", "boosted", "still") if name in gain.one_step]
    lines = ["tip error in mm".ljust(24) + "".join(f"{name:>11}" for name in names)]
    rows = {"one step": gain.one_step, **gain.free_running}
    for name, row in rows.items():
        lines.append(name.ljust(24) + "".join(f"{row[which]:>11.2f}" for which in names if which in row))
    return [*lines, f"judged on: {gain.judged_on}", ""]
