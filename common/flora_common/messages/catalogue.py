"""Every message of the bus, in the order in which a tick brings them about."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from msgspec import Meta

from flora_common.messages.envelope import (
    Ampere,
    Cm,
    Count,
    Fitness,
    Gain,
    Message,
    Microseconds,
    Millimetres,
    MillimetresSd,
    Milliseconds,
    Name,
    OptionalName,
    OptionalSha256,
    Point,
    RelativePath,
    Seconds,
    Sentence,
    Sha256,
    Share,
    message,
)
from flora_common.runs import Light
from flora_common.shapes import STEM_POINTS

Purpose = Literal["run", "background"]
Outcome = Literal["ok", "no_stem", "jumped", "occluded", "touches_edge", "bad_picture", "no_frame"]
MissedBecause = Literal["camera_hung", "camera_gone", "bad_picture", "disk_full", "not_written"]
State = Literal["starting", "ready", "degraded", "fault"]
Stage = Literal["waiting", "stored", "refused"]
OfferStage = Literal["received", "refused", "shadowing", "steering", "returned"]
SimulatedPlant = Literal["typical", "watched"]
Verdict = Literal["nothing_wrong", "explained", "unexplained", "failed"]
JobStage = Literal["waiting", "working", "done", "refused", "failed", "stopped"]

CHUNK_BYTES: Final = 16 * 1024
"""Of a file that is offered, before base64; every chunk but the last has exactly this many."""
MAX_CHUNKS: Final = 62
"""Of the largest controller file, 1 MB."""
MOST_SHADOW_TICKS: Final = 100_000
MOST_CAUSES: Final = 20
MOST_ARGUMENTS: Final = 60
LONGEST_ARGUMENT: Final = 300
OfferId = Annotated[
    str, Meta(pattern=r"^[0-9a-f]{16}$(?!\n)", max_length=16, description="drawn anew by whoever offers")
]
ChunkNumber = Annotated[int, Meta(ge=0, le=MAX_CHUNKS - 1)]


@message("tick", owner="flora-flash", period="tick")
class Tick(Message, kw_only=True, frozen=True):
    """A beat: a photograph is due now."""

    time_s: Annotated[Seconds, Meta(description="since the run's start")]
    purpose: Annotated[Purpose, Meta(description="a frame of the run, or a picture of the empty setup")] = "run"
    shot: Annotated[str, Meta(max_length=64, description="file name of a background picture")] = ""
    late_s: Annotated[Seconds, Meta(description="how long after it was due")] = 0.0
    skipped: Annotated[Count, Meta(description="beats left out because it was hopelessly late")] = 0


@message("flash", owner="flora-flash", period="tick")
class Flash(Message, kw_only=True, frozen=True):
    """The flash lamp changed, or failed to."""

    lit: Annotated[bool, Meta(description="what was asked of it")]
    confirmed: Annotated[bool, Meta(description="whether the lamp says so too")]
    time_s: Seconds = 0.0
    purpose: Purpose = "run"
    shot: Annotated[str, Meta(max_length=64)] = ""
    reason: Annotated[Sentence, Meta(description="why it went dark, or what failed")] = ""


@message("frame", owner="flora-capture", period="tick")
class Frame(Message, kw_only=True, frozen=True):
    """A photograph that is on the disk, whole, before this is said."""

    time_s: Seconds
    path: Annotated[RelativePath, Meta(description="inside the run folder")]
    run: Annotated[Name, Meta(description="name of the run folder")]
    sha256: Sha256
    bytes: Count
    width_px: Annotated[int, Meta(ge=1, le=20_000)]
    height_px: Annotated[int, Meta(ge=1, le=20_000)]
    light: Annotated[Light, Meta(description="lamp that shone when it was taken")]
    flash_confirmed: bool
    exposure_ok: Annotated[bool, Meta(description="the camera's own metadata equal the locked exposure")]
    exposure_note: Annotated[Sentence, Meta(description="what differed")] = ""
    exposure_us: Microseconds = 0.0
    analogue_gain: Gain = 0.0
    digital_gain: Gain = 0.0
    red_gain: Gain = 0.0
    blue_gain: Gain = 0.0
    purpose: Purpose = "run"


@message("frame_missed", owner="flora-capture", period="none")
class FrameMissed(Message, kw_only=True, frozen=True):
    """There is no photograph for this tick, and why."""

    time_s: Seconds
    because: MissedBecause
    reason: Sentence
    purpose: Purpose = "run"
    shot: Annotated[str, Meta(max_length=64)] = ""


@message("stem", owner="flora-stem", period="tick", version=3)
class Stem(Message, kw_only=True, frozen=True):
    """Ten points along the stem, anchor first, tip last; none where no stem was found."""

    time_s: Seconds
    outcome: Outcome
    points_cm: Annotated[
        tuple[Point, ...],
        Meta(max_length=STEM_POINTS, description="(x, y): x right, y up, origin at the anchor; ten or none"),
    ] = ()
    quality: Annotated[Share, Meta(description="share of the ten heights that the picture itself shows")] = 0.0
    light: Light = "dark"
    method: Annotated[Name, Meta(description="how it was found")] = "paper"
    folded: Annotated[bool, Meta(description="the stem turns back and passes some heights more than once")] = False
    uncertainty_mm: Annotated[
        tuple[MillimetresSd, ...],
        Meta(max_length=STEM_POINTS, description="standard deviation of each point; ten or none"),
    ] = ()
    frame_sha256: OptionalSha256 = ""
    run: Annotated[OptionalName, Meta(description="name of the run folder; empty where it is not told")] = ""
    took_ms: Milliseconds = 0.0
    reason: Sentence = ""


@message("light", owner="flora-controller", period="tick")
class LightCommand(Message, kw_only=True, frozen=True):
    """Which lamp is to shine until the next tick."""

    light: Light
    time_s: Seconds = 0.0
    output: Annotated[Share, Meta(description="the network's output; at most 0.5 means left")] = 0.0
    blind: Annotated[bool, Meta(description="decided without a stem, by the blind policy")] = False
    reason: Sentence = ""


@message("controller", owner="flora-controller", period="tick", version=2)
class ControllerState(Message, kw_only=True, frozen=True):
    """What steers, and how well it does."""

    controller: Annotated[Sentence, Meta(description="name of the controller file or light plan, or built-in name")]
    sha256: Annotated[OptionalSha256, Meta(description="of that file; empty for built-in ones")] = ""
    time_s: Seconds = 0.0
    fitness: Annotated[Fitness | None, Meta(description="the paper's F of the present tip")] = None
    best_fitness: Fitness | None = None
    tip_cm: Point | None = None
    target_reached: bool = False
    collided: Annotated[bool, Meta(description="the stem has touched the obstacle at some time")] = False
    collided_at_s: Seconds | None = None
    clearance_cm: Annotated[Cm | None, Meta(description="smallest distance of stem and obstacle so far")] = None
    blind_ticks: Annotated[Count, Meta(description="ticks in a row without a stem")] = 0
    decisions: Count = 0
    switches: Annotated[Count, Meta(description="changes of lamp so far")] = 0
    run_over: Annotated[
        bool, Meta(description="a stop rule holds: height reached, obstacle touched, or a light plan at its end")
    ] = False
    reason: Annotated[
        Sentence, Meta(description="the stop rule, why a controller file was refused, why one was returned from")
    ] = ""
    shadow: Annotated[
        Sentence, Meta(description="name of a new controller that is asked beside the one that shines; empty for none")
    ] = ""
    shadow_sha256: OptionalSha256 = ""
    shadow_output: Annotated[Share | None, Meta(description="what it answered this tick; none where not asked")] = None
    shadow_light: Annotated[Light | None, Meta(description="the lamp that it would have lit")] = None
    shadow_ticks: Annotated[Count, Meta(description="ticks that it has answered so far")] = 0
    shadow_ticks_left: Annotated[Count, Meta(description="ticks to go until it steers")] = 0
    shadow_agree: Annotated[Share | None, Meta(description="share of those ticks with the lamp that shone")] = None


@message("lamps", owner="flora-led", period="tick")
class Lamps(Message, kw_only=True, frozen=True):
    """What is really lit, read back from the bytes that went to the strips."""

    lit: Light
    commanded: Light
    current_a: Annotated[Ampere, Meta(description="drawn by both strips together, computed from the bytes")] = 0.0
    scale: Annotated[Share, Meta(description="brightness left over by the current cap; 1 is uncapped")] = 1.0
    fallback: Annotated[bool, Meta(description="no fresh command: the stated fallback shines")] = False
    setup_step: Annotated[Count, Meta(description="step of a setup run that this answers; 0 for none")] = 0
    reason: Sentence = ""


@message("setup", owner="flora-stem", period="none", keep=False)
class Setup(Message, kw_only=True, frozen=True):
    """A setup run asks for lamps, then for a picture; the beat rests while it is active.

    Said again every 15 s, and not kept: a run that ended without a word is over for whoever starts later.
    """

    active: bool
    step: Annotated[Count, Meta(description="from 1; each step is one lamp state and one picture")] = 0
    steps: Count = 0
    lamps: Light = "dark"
    shot: Annotated[str, Meta(max_length=64, pattern=r"^([a-z0-9][a-z0-9_-]*\.jpg)?$(?!\n)")] = ""


@message("stored", owner="flora-uploader", period="none")
class Stored(Message, kw_only=True, frozen=True):
    """A file of record at the NAS, or why it is not."""

    stage: Stage
    path: Annotated[str, Meta(max_length=255)] = ""
    sha256: OptionalSha256 = ""
    bytes: Count = 0
    destination: Sentence = ""
    waiting: Annotated[Count, Meta(description="files of record not yet verified at the NAS")] = 0
    stored: Annotated[Count, Meta(description="files verified so far")] = 0
    reason: Sentence = ""


@message("recording", owner="flora-recorder", period="none")
class Recording(Message, kw_only=True, frozen=True):
    """The recording that is being written."""

    path: RelativePath
    messages: Count = 0
    bytes: Count = 0
    bad: Annotated[Count, Meta(description="messages recorded raw because they do not fit the catalogue")] = 0
    closed: bool = False


@message("controller_offer", owner="flora-lab", period="none", keep=False)
class ControllerOffer(Message, kw_only=True, frozen=True):
    """A controller file that a rig is to take; its bytes follow in chunks. Said again, it asks what is missing."""

    offer: OfferId
    name: Annotated[Sentence, Meta(description="of the file, for people")]
    sha256: Annotated[Sha256, Meta(description="of the whole file")]
    bytes: Annotated[int, Meta(ge=1, le=CHUNK_BYTES * MAX_CHUNKS)]
    chunks: Annotated[int, Meta(ge=1, le=MAX_CHUNKS, description="of 16384 bytes each, the last one shorter")]
    shadow_ticks: Annotated[
        int, Meta(ge=0, le=MOST_SHADOW_TICKS, description="ticks in shadow before it steers; the rig may ask for more")
    ] = 0


@message("controller_chunk", owner="flora-lab", period="none", keep=False)
class ControllerChunk(Message, kw_only=True, frozen=True):
    """A piece of the file that was offered."""

    offer: OfferId
    number: Annotated[ChunkNumber, Meta(description="from 0")]
    data: Annotated[str, Meta(max_length=CHUNK_BYTES * 4 // 3 + 4, description="base64")]


@message("controller_answer", owner="flora-controller", period="none")
class ControllerAnswer(Message, kw_only=True, frozen=True):
    """What has become of an offer. Said at each change, and whenever the offer is said again."""

    offer: OfferId
    stage: Annotated[
        OfferStage,
        Meta(
            description="received: known, chunks are missing; refused: never steered; shadowing: accepted, and asked "
            "beside the old one; steering; returned: accepted, and given up since"
        ),
    ]
    sha256: Sha256
    missing: Annotated[
        tuple[ChunkNumber, ...], Meta(max_length=MAX_CHUNKS, description="chunks that have not arrived")
    ] = ()
    shadow_ticks_left: Count = 0
    steers: Annotated[Sentence, Meta(description="name of the controller that steers now")] = ""
    reason: Sentence = ""


@message("departure", owner="flora-lab", period="none")
class Departure(Message, kw_only=True, frozen=True):
    """A plant departs from its simulator while its run lasts, or is as expected again. Said when that changes."""

    run: Annotated[Name, Meta(description="name of the run folder")]
    is_departed: bool
    hours: Annotated[Count, Meta(description="whole hours of the run that were looked at")] = 0
    tip_error_mm: Annotated[
        Millimetres, Meta(description="distance of measured and simulated tip, mean over the last hour")
    ] = 0.0
    right_mm: Annotated[Millimetres, Meta(description="how far the measured tip is to the right of it")] = 0.0
    up_mm: Annotated[Millimetres, Meta(description="how far it is above it")] = 0.0
    expected_mm: Annotated[
        Millimetres, Meta(description="distance that chance and individuals allow: 95 % of plants are within it")
    ] = 0.0
    compared_with: Annotated[
        SimulatedPlant, Meta(description="the typical plant, or this one after it was watched for a day")
    ] = "typical"
    sentence: Sentence = ""


@message("diagnosis", owner="flora-lab", period="none")
class DiagnosisFound(Message, kw_only=True, frozen=True):
    """What was found in a run that has ended, or that it could not be diagnosed."""

    run: Annotated[Name, Meta(description="name of the run folder")]
    verdict: Verdict
    plant: Annotated[str, Meta(max_length=200)] = ""
    causes: Annotated[
        tuple[Name, ...], Meta(max_length=MOST_CAUSES, description="effects that were found, the surest first")
    ] = ()
    confidence: Annotated[
        tuple[Share, ...], Meta(max_length=MOST_CAUSES, description="of each of them: its probability")
    ] = ()
    path: Annotated[str, Meta(max_length=500, description="folder of the diagnosis, at the lab's machine")] = ""
    track_sha256: OptionalSha256 = ""
    sentence: Sentence = ""


@message("job", owner="flora-lab", period="none", keep=False)
class Job(Message, kw_only=True, frozen=True):
    """Work that a lab is asked to do, as ``flora-lab WORK ARGUMENTS`` would. Said again, it asks how the job is."""

    job: Annotated[OfferId, Meta(description="drawn anew by whoever asks")]
    work: Annotated[Name, Meta(description="a subcommand of flora-lab, such as train or evolve")]
    arguments: Annotated[
        tuple[Annotated[str, Meta(max_length=LONGEST_ARGUMENT)], ...],
        Meta(max_length=MOST_ARGUMENTS, description="its arguments; paths are relative to the folder of all jobs"),
    ] = ()
    stop: Annotated[bool, Meta(description="no longer: end it, or take it from those that wait")] = False


@message("job_progress", owner="flora-lab", period="none")
class JobProgress(Message, kw_only=True, frozen=True):
    """What has become of a job. Said at each change, every few seconds while it is worked at, and when it is asked."""

    job: OfferId
    work: Name
    stage: Annotated[
        JobStage, Meta(description="refused: never begun; failed: ended without a result; stopped: by whoever asked")
    ]
    share: Annotated[
        Share | None, Meta(description="of the present part of the work; none where that is not known")
    ] = None
    text: Annotated[Sentence, Meta(description="what is done now, why it failed, or what the work said last")] = ""
    before: Annotated[Count, Meta(description="jobs that come first")] = 0
    took_s: Seconds = 0.0


@message("health", owner="every service", period="10 s", per_source=True)
class Health(Message, kw_only=True, frozen=True):
    """How a service is, in one word and one sentence."""

    state: State
    reason: Sentence = ""
    version: Annotated[str, Meta(max_length=64)] = ""
    config_sha256: OptionalSha256 = ""
    uptime_s: Annotated[Seconds, Meta(description="real seconds")] = 0.0
    resident_kib: Annotated[Count, Meta(description="resident memory")] = 0
    sent: Count = 0
    received: Count = 0
    gaps: Annotated[Count, Meta(description="messages lost on the way here, by sequence number")] = 0
    bad: Annotated[Count, Meta(description="messages that do not fit the catalogue")] = 0
    unknown: Annotated[Count, Meta(description="messages of a kind that is not in the catalogue")] = 0
    duplicates: Annotated[Count, Meta(description="kept values heard again, left out")] = 0
    slowest_ms: Annotated[Milliseconds, Meta(description="longest step of the working loop since the last health")] = 0
