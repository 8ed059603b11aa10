"""All faults of a script, by kind of device, with their parameters."""

from collections.abc import Mapping
from dataclasses import dataclass, field

SHARE = {"share": 1.0}
"""Share of the messages, drawn for each."""


@dataclass(frozen=True)
class Kind:
    """A fault in one line, and its parameters with defaults, all numbers."""

    summary: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    lasts: bool = True
    """Whether ``for`` applies: an instantaneous event has no duration."""


WIRE = {
    "lost": Kind("messages of the device do not arrive", SHARE),
    "delayed": Kind("messages arrive late", SHARE | {"seconds": 0.3}),
    "corrupted": Kind("some bits of a message are turned over", SHARE | {"bits": 3}),
    "truncated": Kind("a message ends early", SHARE),
    "duplicated": Kind("a message arrives twice", SHARE),
    "garbage": Kind(
        "bytes that look like the beginning of a message, stuffed and not, come before it", SHARE
    ),
    "unplugged": Kind("the serial adapter is pulled out; it comes back under another name"),
}

CATALOGUE: dict[str, dict[str, Kind]] = {
    "servo bus": WIRE
    | {
        "power-cut": Kind("the servos have no power; when it comes back they have forgotten their set-up"),
    },
    "servo": {
        "overload": Kind("hardware error: overload; the torque goes off until a reboot", lasts=False),
        "overheating": Kind("the motor gets too hot", {"temperature_c": 95.0}),
        "voltage-low": Kind("the supply voltage is too low", {"volts": 8.0}),
        "encoder-error": Kind("hardware error: motor encoder", lasts=False),
        "alert": Kind("the alert bit is set although no hardware error is"),
        "reboot": Kind("the servo restarts: torque off, RAM forgotten", lasts=False),
        "backlash": Kind("the gear gets play", {"degrees": 1.5}),
        "blocked": Kind("the shaft cannot turn"),
        "silent": Kind("the servo does not answer: a broken wire"),
    },
    "talker": WIRE
    | {
        "frozen": Kind("the instrument repeats its last message for ever"),
    },
    "chip": {
        "nack": Kind("the chip does not acknowledge", SHARE),
        "stuck": Kind("the bus is stuck: transfers fail with an I/O error", SHARE),
        "stretched": Kind("the chip holds the clock until the transfer times out", SHARE | {"seconds": 0.2}),
        "corrupted": Kind("some bits of what is read are turned over", SHARE | {"bits": 3}),
        "truncated": Kind("fewer bytes than asked for are read", SHARE),
        "reset": Kind("the chip restarts and has lost its configuration", lasts=False),
        "frozen": Kind("the chip repeats its last measurement"),
        "no-conversion": Kind("the chip has no measurement to give"),
    },
    "camera": {
        "stalled": Kind("the stream stays open and sends nothing"),
        "disconnected": Kind("the stream ends, and the camera accepts no other"),
        "black": Kind("the pictures are black"),
        "over-exposed": Kind("the pictures are far too bright", {"gain": 12.0}),
        "burnt-out": Kind("the sky is so bright that it burns out the ridge", {"gain": 2.5}),
        "frozen": Kind("the last picture is sent again and again"),
        "stale": Kind("the pictures are old ones", {"seconds": 3.0}),
        "resolution": Kind("the pictures have another size", {"width_px": 320, "height_px": 240}),
        "blurred": Kind("the pictures are blurred", {"sigma_px": 8.0}),
    },
    "clock": {
        "stepped": Kind("the wall clock steps", {"seconds": 3600.0}),
    },
    "disk": {
        "full": Kind("no file of the command can grow any further", {"largest_file_bytes": 65536}),
        "read-only": Kind("nothing can be made where the bundles go"),
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
