"""``flora-lab track``: the order of its work."""

from __future__ import annotations

import contextlib
import itertools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import typer

from flora_common import files, outputs
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import EmptySetup
from flora_common.vision.paper import PaperSettings
from flora_common.vision.path.settings import PathSettings
from flora_lab.lights import parse_rule
from flora_lab.option_values import must_not
from flora_lab.sources import FilmSource, FolderSource, RunSource, open_source
from flora_lab.stopped_work import sigterm_ends
from flora_lab.track import learning, options, screen
from flora_lab.track.drawing import DrawReadings
from flora_lab.track.following import follow_frames
from flora_lab.track.learning import Learnt, Sorted
from flora_lab.track.methods import Method, PaperMethod, PathMethod
from flora_lab.track.part_file import PartFile
from flora_lab.track.pictures import Pictures, Wanted
from flora_lab.track.pool import Pool
from flora_lab.track.readings import Span, Summary
from flora_lab.track.tables import own_columns, track_text


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("track")(track)


def track(
    input_path: options.InputArgument,
    *,
    output: options.OutputOption = Path("track.csv"),
    force: options.ForceOption = False,
    method: options.MethodOption = options.MethodName.PATH,
    jobs: options.JobsOption = None,
    resume: options.ResumeOption = True,
    frames: options.FramesOption = ":",
    anchor: options.AnchorOption = None,
    px_per_cm: options.ScaleOption = None,
    window: options.WindowOption = None,
    reduction: options.ReductionOption = None,
    interval_s: options.IntervalOption = None,
    light_from: options.LightOption = None,
    widest_stem_cm: options.WidestOption = None,
    hidden_base_cm: options.HiddenBaseOption = None,
    below_anchor_cm: options.BelowAnchorOption = None,
    points: options.PointsOption = None,
    theta_1: options.Theta1Option = None,
    theta_2_px: options.Theta2Option = None,
    smallest_component: options.SmallestOption = None,
    overlays: options.OverlaysOption = None,
    contact: options.ContactOption = None,
    film: options.FilmOption = None,
    every: options.EveryOption = None,
    quiet: options.QuietOption = False,
    as_json: options.JsonOption = False,
) -> None:
    """Find the stem in every photograph and write it as a track.

    A run folder brings anchor, scale, times, lamps and background pictures with it.

    For a folder of pictures or a film give --anchor and --px-per-cm.

    Without background pictures the empty setup is learnt from the frames themselves.

    The same command, given again after it was killed, goes on where it was.
    """
    outputs.check_file(output, force=force, is_ours=outputs.is_track, what="a track")
    wanted = Wanted(overlays, contact, film, every)
    wanted.check(output, force=force)
    span = options.span_of(frames)
    rule = parse_rule(light_from or options.LIGHT_RULE)
    source = open_source(input_path)
    wanted.check_apart(output, source)
    if isinstance(source, RunSource):
        must_not("--interval-s", interval_s, f"{source.folder.frames_csv} tells the times")
        must_not("--light-from", light_from, f"{source.folder.frames_csv} tells the lamps")
    between_s = options.INTERVAL_S if interval_s is None else interval_s
    count = len(span.indices(source.count))
    if count == 0:
        raise BadInput(f"--frames: no frame between {frames}; {source.name} has {source.count}, counted from 0")
    camera = options.camera_of(source, anchor, px_per_cm)
    settings = options.settings_of(
        method,
        source,
        window=window,
        reduction=reduction,
        path={
            "widest_stem_cm": widest_stem_cm,
            "hidden_base_cm": hidden_base_cm,
            "below_anchor_cm": below_anchor_cm,
            "points": None if points is None else points.value,
        },
        paper={
            "theta_1": theta_1,
            "theta_2_px": theta_2_px,
            "smallest_component_px": smallest_component,
        },
    )
    path = isinstance(settings, PathSettings)
    _no_clash(source, own_columns(method_columns=path))
    work = {
        "input": source.fingerprint(),
        "method": method.value,
        "settings": msgspec.to_builtins(settings),
        "camera": msgspec.to_builtins(camera),
        "first frame": span.first,
        "frames before": span.end,
        "lights": light_from,
        "interval_s": between_s,
    }
    silent = quiet or as_json
    with (
        sigterm_ends(),
        Pool(options.jobs_of(jobs, count)) as pool,
        PartFile(output, work, span.indices(source.count), fresh=not resume) as part,
        _kept_told(part, count, silent=silent),
        screen.progress(silent) as stage,
    ):
        resumed = len(part.readings)
        if resumed and not silent:
            print(f"going on after {resumed} of {counted(count, 'frame')}, from {part.path}", file=sys.stderr)
        looks = learning.needs_a_look(source, rule, path=path)
        looked = stage("lamp states", count) if looks else lambda: None
        lamps = learning.sort_frames(source, span, rule, pool, path=path, on_frame=looked)
        learnt, how = _prepare(source, camera, settings, lamps, stage, between_s)
        how.memory = part.memory
        found = stage("stems", count, resumed)
        rest = Span(span.first + resumed, span.end).take(source.frames())
        for reading in follow_frames(rest, how, pool, lights=lamps.lights, interval_s=between_s):
            part.add(reading, how.memory)
            found()
        summary = _summed(source, part)
        if wanted.any:
            sights = (source.obstacle, source.target) if isinstance(source, RunSource) else (None, None)
            with Pictures(wanted, part.readings, DrawReadings(camera, *sights)) as pictures:
                pictures.draw(source, pool, on_picture=stage("pictures", pictures.count))
                pictures.finish()
        files.write_text(output, track_text(part.readings, method_columns=path))
        part.remove()
    told = screen.Outcome(source.name, method.value, output, wanted, summary, learnt, lamps, pool.jobs, resumed)
    screen.tell(told, quiet=quiet, as_json=as_json)


@contextlib.contextmanager
def _kept_told(part: PartFile, count: int, *, silent: bool) -> Iterator[None]:
    """Say what Ctrl-C or SIGTERM leaves to go on from, of ``count`` frames."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        if part.readings and not silent:
            kept = f"{len(part.readings)} of {counted(count, 'frame')} are kept in {part.path}"
            print(f"{kept}; the same command goes on from there", file=sys.stderr)
        raise


def _prepare(
    source: RunSource | FolderSource | FilmSource,
    camera: CameraSection,
    settings: PathSettings | PaperSettings,
    lamps: Sorted,
    stage: screen.Stage,
    between_s: float,
) -> tuple[Learnt, Method]:
    """The empty setup, and the method that stands on it."""
    background = source.background() if isinstance(source, RunSource) else []
    learns = stage("empty setup", None)
    how: Method
    try:
        if isinstance(settings, PathSettings):
            learnt = learning.path_setup(source, background, camera, settings, lamps, on_frame=learns)
            assert isinstance(learnt.setup, EmptySetup)
            how = PathMethod(learnt.setup, camera, settings, shortest_gap_s=_shortest_gap_s(source, between_s))
        else:
            learnt = learning.paper_setup(source, background, settings, lamps, on_frame=learns)
            assert not isinstance(learnt.setup, EmptySetup)
            how = PaperMethod(learnt.setup, camera, settings)
    except BadInput as problem:
        named = str(problem).startswith(source.name)
        raise problem if named else BadInput(f"{source.name}: {problem}") from problem
    return learnt, how


def _shortest_gap_s(source: RunSource | FolderSource | FilmSource, between_s: float) -> float:
    """Between two frames, where times are not told ``between_s``."""
    if not isinstance(source, RunSource):
        return between_s
    times_s = [row.time_s for row in source.rows]
    return min((after - before for before, after in itertools.pairwise(times_s)), default=between_s)


def _summed(source: RunSource | FolderSource | FilmSource, part: PartFile) -> Summary:
    """What was found in all frames; :class:`BadInput` where that is no stem."""
    summary = Summary()
    for reading in part.readings:
        summary.add(reading)
    if summary.readings == 0:
        part.remove()  # the same work would come to the same end
        first = f"; the first: {summary.bad[0]}" if summary.bad else ""
        raise BadInput(
            f"{source.name}: no stem in any of {counted(summary.frames, 'frame')} ({summary.outcome_words()}){first}; "
            "nothing was written; see --anchor, --window and --overlays"
        )
    return summary


def _no_clash(source: RunSource | FolderSource | FilmSource, own: Sequence[str]) -> None:
    """Before any work: a track in which a column's name stands twice is read by nothing."""
    covariates = {name for row in source.rows for name in row.covariates} if isinstance(source, RunSource) else set()
    for name in own:
        if name in covariates:
            raise BadInput(f"{source.name}: frames.csv has a column `{name}`, which the track needs; rename it")
