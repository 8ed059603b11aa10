"""Documents that are no documents: each was a traceback, a hang, gigabytes, or two readings of one file somewhere."""

from localizer.documents import DEEPEST

BOM = b"\xef\xbb\xbf"
JSON_ATTACKS = {
    "brackets": b"[" * 100_000,
    "objects": b'{"a":' * 100_000,
    "nested a little": b"[" * (DEEPEST + 1) + b"]" * (DEEPEST + 1),
    "digits": b'{"id": ' + b"9" * 5000 + b"}",
    "more digits": b'{"id": ' + b"9" * 400 + b"}",
    "beyond a double": b'{"id": 1e999}',
    "NaN": b'{"id": NaN}',
    "Infinity": b'{"id": -Infinity}',
    "a name twice": b'{"id": "a", "id": "b"}',
    "a name twice, late": b"{" + b"".join(b'"%05d":1,' % i for i in range(90_000)) + b'"id":1,"id":2}',
    "half a surrogate": b'{"id": "\\ud800"}',
    "half a surrogate as a name": b'{"\\udfff": 1}',
    "a zero": b'{"id": "a\\u0000b"}',
    "not UTF-8": b'{"id": "\xff"}',
    "overlong": b'{"id": "\xc0\xaf"}',
    "UTF-16": '{"id": "a"}'.encode("utf-16"),
    "values": b"[" + b"0," * 600_000 + b"0]",
    "nothing": b"",
    "a byte order mark alone": BOM,
    "two byte order marks": BOM + BOM + b"{}",
    "cut off": b'{"id": "',
}
TOML_ATTACKS = {
    "arrays": b"a = " + b"[" * 20_000,
    "tables": b"a = " + b"{a = " * 20_000,
    "a dotted key": b".".join([b"a"] * 200_000) + b" = 1",
    "a dotted table": b"[" + b".".join([b"a"] * 200_000) + b"]",
    "a spaced dotted key": b" . ".join([b"'a'"] * 50_000) + b" = 1",
    "digits": b"a = " + b"9" * 5000,
    "hexadecimal digits": b"a = 0x" + b"f" * 5000,
    "a date": b"a = 2026-13-45",
    "a time": b"a = 25:61:00",
    "inf": b"a = inf",
    "nan": b"[a]\nb = -nan",
    "a zero": b'a = "a\\u0000b"',
    "half a surrogate": b'a = "\\ud800"',
    "a key twice": b"a = 1\na = 2",
    "not UTF-8": b'a = "\xe9"',
    "UTF-16": "a = 1".encode("utf-16"),
    "cut off": b'a = "',
}
