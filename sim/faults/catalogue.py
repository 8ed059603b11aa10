"""All faults of a script, by kind of device, with their parameters."""

from collections.abc import Mapping
from dataclasses import dataclass, field

SHARE = {"share": 1.0}
"""Share of the messages, drawn for each."""


@dataclass(frozen=True)
class FaultKind:
    """A fault in one line, and its parameters with defaults, all numbers."""

    summary: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    lasts: bool = True
    """Whether ``for`` applies: an instantaneous event has no duration."""


WIRE = {
    "lost": FaultKind("messages of the device do not arrive", SHARE),
    "delayed": FaultKind("messages arrive late", SHARE | {"seconds": 0.3}),
    "corrupted": FaultKind("some bits of a message are turned over", SHARE | {"bits": 3}),
    "truncated": FaultKind("a message ends early", SHARE),
    "duplicated": FaultKind("a message arrives twice", SHARE),
    "garbage": FaultKind(
        "bytes that look like the beginning of a message, stuffed and not, come before it", SHARE
    ),
    "unplugged": FaultKind("the serial adapter is pulled out; it comes back under another name"),
}

CATALOGUE: dict[str, dict[str, FaultKind]] = {
    "servo bus": WIRE
    | {
        "power-cut": FaultKind(
            "the servos have no power; when it comes back they have forgotten their set-up"
        ),
    },
    "servo": {
        "overload": FaultKind("hardware error: overload; the torque goes off until a reboot", lasts=False),
        "overheating": FaultKind("the motor gets too hot", {"temperature_c": 95.0}),
        "voltage-low": FaultKind("the supply voltage is too low", {"volts": 8.0}),
        "encoder-error": FaultKind("hardware error: motor encoder", lasts=False),
        "alert": FaultKind("the alert bit is set although no hardware error is"),
        "reboot": FaultKind("the servo restarts: torque off, RAM forgotten", lasts=False),
        "backlash": FaultKind("the gear gets play", {"degrees": 1.5}),
        "blocked": FaultKind("the shaft cannot turn"),
        "silent": FaultKind("the servo does not answer: a broken wire"),
    },
    "talker": WIRE
    | {
        "frozen": FaultKind("the instrument repeats its last message for ever"),
    },
    "chip": {
        "nack": FaultKind("the chip does not acknowledge", SHARE),
        "stuck": FaultKind("the bus is stuck: transfers fail with an I/O error", SHARE),
        "stretched": FaultKind(
            "the chip holds the clock until the transfer times out", SHARE | {"seconds": 0.2}
        ),
        "corrupted": FaultKind("some bits of what is read are turned over", SHARE | {"bits": 3}),
        "truncated": FaultKind("fewer bytes than asked for are read", SHARE),
        "reset": FaultKind("the chip restarts and has lost its configuration", lasts=False),
        "frozen": FaultKind("the chip repeats its last measurement"),
        "no-conversion": FaultKind("the chip has no measurement to give"),
    },
    "camera": {
        "stalled": FaultKind("the stream stays open and sends nothing"),
        "disconnected": FaultKind("the stream ends, and the camera accepts no other"),
        "black": FaultKind("the pictures are black"),
        "over-exposed": FaultKind("the pictures are far too bright", {"gain": 12.0}),
        "burnt-out": FaultKind("the sky is so bright that it burns out the ridge", {"gain": 2.5}),
        "frozen": FaultKind("the last picture is sent again and again"),
        "stale": FaultKind("the pictures are old ones", {"seconds": 3.0}),
        "resolution": FaultKind("the pictures have another size", {"width_px": 320, "height_px": 240}),
        "blurred": FaultKind("the pictures are blurred", {"sigma_px": 8.0}),
    },
    "clock": {
        "stepped": FaultKind("the wall clock steps", {"seconds": 3600.0}),
    },
    "disk": {
        "full": FaultKind("no file of the command can grow any further", {"largest_file_bytes": 65536}),
        "read-only": FaultKind("nothing can be made where the bundles go"),
    },
}
"""Group of devices -> fault -> what it is."""

DEVICES: dict[str, tuple[str, ...]] = {
    "servo-bus": ("servo bus",),
    "pan": ("servo",),
    "tilt": ("servo",),
    "inclinometer": ("chip",),
    "compass": ("chip", "talker"),
    "altimeter": ("chip", "talker"),
    "camera": ("camera",),
    "clock": ("clock",),
    "disk": ("disk",),
}
"""Device of a script -> its possible groups, depending on the scenario."""
