"""Validates the lines of a log of ``rig record`` before a device is played from them."""

from collections.abc import Mapping
from typing import Any

MAX_TRANSFER = 1 << 16


def check_exchange(exchange: Any) -> None:
    """Raises ``ValueError`` unless it is a bus transfer or bytes of a port, as in docs/recording.md."""
    if not isinstance(exchange, Mapping):
        raise ValueError("it is no JSON object")
    _number(exchange, "t")
    if "port" in exchange:
        _text(exchange, "port")
        _bytes(exchange, "sent" if "sent" in exchange else "received")
    elif "bus" in exchange:
        _text(exchange, "bus")
        _whole(exchange, "address", 0x7F)
        _bytes(exchange, "write")
        _whole(exchange, "length", MAX_TRANSFER)
        if "errno" in exchange:
            _whole(exchange, "errno", 4095)
        else:
            _bytes(exchange, "read")
    else:
        raise ValueError("it names neither a port nor a bus")


def check_config(config: Any) -> None:
    """Raises ``ValueError`` unless it can be a header's configuration: sections, one of them a camera's."""
    if not isinstance(config, Mapping) or not all(
        isinstance(section, Mapping) for section in config.values()
    ):
        raise ValueError("its header holds no configuration")
    camera = config.get("camera")
    if camera is None:
        raise ValueError("its header holds no configuration with a [camera] in it")
    for key in ("width_px", "height_px"):
        _whole(camera, key, 32768)
    if camera["width_px"] * camera["height_px"] > 150_000_000:
        raise ValueError("its camera has more pixels than any camera")


def _number(fields: Mapping[str, Any], key: str) -> None:
    value = fields.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < 1e9:
        raise ValueError(f"{key} is no number of seconds")


def _whole(fields: Mapping[str, Any], key: str, most: int) -> None:
    value = fields.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise ValueError(f"{key} is no whole number up to {most}")


def _text(fields: Mapping[str, Any], key: str) -> None:
    if not isinstance(fields.get(key), str) or not fields[key].isprintable():
        raise ValueError(f"{key} is no name")


def _bytes(fields: Mapping[str, Any], key: str) -> None:
    value = fields.get(key)
    try:
        data = bytes.fromhex(value) if isinstance(value, str) else None
    except ValueError:
        data = None
    if data is None or len(data) > MAX_TRANSFER:
        raise ValueError(f"{key} is no bytes in hexadecimal digits")
