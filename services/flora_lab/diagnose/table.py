"""A diagnosis as text on a terminal."""

from __future__ import annotations

from flora_lab.diagnose import controllers_told, gain_told, learned_told
from flora_lab.diagnose.residual_words import percent_sure
from flora_lab.diagnose.summary import set_right, title
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
    lines += gain_told.lines(found.gain)
    lines += controllers_told.lines(found.gain.controller_fitness)
    if found.next_experiment.why:
        lines += [f"next: {found.next_experiment.why}", ""]
    lines += [f"record: {note}" for note in found.record]
    if found.corrected:
        lines.append(f"record: {set_right(found.corrected)}")
    return "\n".join(lines) + "\n"
