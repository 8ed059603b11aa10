"""Removes user, password and tokens from camera addresses before they are shown."""

import re

_SECRET = re.compile(
    r"(?i)\b(\w*(?:pass|pwd|token|secret|auth|key|user|usr|login|session|credential|sid|sig)\w*)=([^&/#;?\s]*)"
)

_AT = re.compile(r"(?P<scheme>\w+:)?//(?P<rest>.*)", re.DOTALL)

HIDDEN = "***"


def shown(source: object) -> str:
    """A camera's source without user, password and tokens: for messages, logs, bundles and pages."""
    text = str(source)
    match = _AT.match(text)
    if match:
        text = f"{match['scheme'] or ''}//{_without_user(match['rest'])}"
        return _SECRET.sub(rf"\1={HIDDEN}", text)
    return text


def _without_user(rest: str) -> str:
    host = re.split(r"[/?#]", rest, maxsplit=1)[0]
    if "@" in host:
        return rest[: len(host)].rpartition("@")[2] + rest[len(host) :]
    before, _, after = rest.rpartition("@")
    # A password with an unescaped slash (%2F): the text before it is no port.
    if before and ":" in host and not re.fullmatch(r"(\[[^]]*\]|[^:]*):\d{1,5}", host):
        return after
    return rest


def without_secrets(message: str, *sources: object) -> str:
    """A library's message with the sources in it, and credentials before their hosts, as ``shown`` gives them."""
    for source in sources:
        text = str(source)
        if "//" not in text:
            continue
        message = message.replace(text, shown(text))
        user, at, _ = text.partition("//")[2].rpartition("@")
        if at:
            name, _, password = user.partition(":")
            for part in sorted({user, name, password}, key=len, reverse=True):
                if len(part) > 2:
                    message = message.replace(part, HIDDEN)
    return message
