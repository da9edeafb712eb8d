"""The message catalogue: every topic of the bus, its type, its bounds, and how bytes become messages.

``python -m flora_common.messages`` writes the reference page and the JSON Schema from it.
"""

from flora_common.messages.catalogue import (
    ControllerAnswer,
    ControllerChunk,
    ControllerOffer,
    ControllerState,
    Departure,
    DiagnosisFound,
    Flash,
    Frame,
    FrameMissed,
    Health,
    Job,
    JobProgress,
    Lamps,
    LightCommand,
    Recording,
    Setup,
    Stem,
    Stored,
    Tick,
)
from flora_common.messages.envelope import CATALOGUE, Message, Period, TopicSpec, spec_of
from flora_common.messages.wire import MAX_PAYLOAD_BYTES, decode, encode, split_topic, topic_of

__all__ = [
    "CATALOGUE",
    "MAX_PAYLOAD_BYTES",
    "ControllerAnswer",
    "ControllerChunk",
    "ControllerOffer",
    "ControllerState",
    "Departure",
    "DiagnosisFound",
    "Flash",
    "Frame",
    "FrameMissed",
    "Health",
    "Job",
    "JobProgress",
    "Lamps",
    "LightCommand",
    "Message",
    "Period",
    "Recording",
    "Setup",
    "Stem",
    "Stored",
    "Tick",
    "TopicSpec",
    "decode",
    "encode",
    "spec_of",
    "split_topic",
    "topic_of",
]
