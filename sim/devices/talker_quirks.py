"""Non-standard sentences of real talkers, by name, written from field reports: the same truth in another form.

They cover the rows under "Talkers" in docs/reports.md that concern a line on the wire.
"""

from collections.abc import Callable

from sim.devices.talkers import HPA_PER_INHG, Air, Heading, hdg, hdm, sentence


def _deg(degrees: float) -> str:
    return f"{round(degrees * 10) % 3600 / 10:.1f}"


def _side(declination_deg: float) -> str:
    return f"{abs(declination_deg):.1f},{'E' if declination_deg >= 0 else 'W'}"


def _magnetic(heading: Heading, form: str) -> bytes:
    return sentence(form.format(_deg(heading.magnetic_heading_deg)))


def _without_checksum(line: bytes) -> bytes:
    return line.partition(b"*")[0] + b"\r\n"


def _hdg_twice(heading: Heading) -> bytes:
    variation = _side(heading.declination_deg)
    return _magnetic(heading, f"HCHDG,{{}},{variation},{variation}")


def _two_compasses(heading: Heading) -> bytes:
    return hdm(heading) + sentence(f"TIHDM,{_deg(heading.magnetic_heading_deg + 20.0)},M")


COMPASS_QUIRKS: dict[str, Callable[[Heading], bytes]] = {
    "variation-zero": lambda h: _magnetic(h, "HCHDG,{},0.0,E,0.0,E"),
    "variation-as-deviation": lambda h: _magnetic(h, f"HCHDG,{{}},{_side(h.declination_deg)},,"),
    "variation-twice": _hdg_twice,
    "magnetic-as-true": lambda h: hdm(h) + _magnetic(h, "HCHDT,{},T"),
    "true-marked-magnetic": lambda h: _magnetic(h, "HCHDT,{},M"),
    "no-value": lambda h: b"".join(
        sentence(body) for body in ("HCHDG,,,,,", "HCHDG,,,,0.2,E", "GPHDT,,T", "GPTHS,,V")
    ),
    "manual": lambda h: _magnetic(h, "GPTHS,{},M"),
    "no-checksum": lambda h: _without_checksum(hdm(h)),
    "carriage-return": lambda h: hdm(h).replace(b"\r\n", b"\r"),
    "zero-byte": lambda h: hdm(h).replace(b"\r\n", b"\x00\r\n"),
    "tagged": lambda h: (
        sentence("AIVDM,1,1,,A,13u?etPv2;0n:dDPwUM1U1Cb069D,0").replace(b"$", b"!")
        + b"\\s:HC01*3C\\"
        + hdm(h)
    ),
    "whole-degrees": lambda h: sentence(f"HCHDM,{round(h.magnetic_heading_deg) % 360},M"),
    "two-compasses": _two_compasses,
    "hdg-and-hdm": lambda h: hdg(h) + hdm(h),
}


def _bar(air: Air, decimals: int = 4) -> str:
    return f"{air.pressure_hpa / 1000.0:.{decimals}f}"


ENGINE = "ERXDR,P,300000,P,ENGINEOIL#0,C,89.5,C,ENGINE#0,U,13.4,V,ALTERNATOR#0,G,250,,Engine#0"

BAROMETER_QUIRKS: dict[str, Callable[[Air], bytes]] = {
    "two-decimals": lambda a: sentence(f"IIXDR,P,{_bar(a, 2)},B,Barometer"),
    "engine-first": lambda a: sentence(ENGINE) + sentence(f"WIXDR,P,{_bar(a)},B,Barometer"),
    "two-pressures": lambda a: sentence(f"WIXDR,P,95000,P,ENGINEBOOST#0,P,{_bar(a)},B,Barometer"),
    "empty-group": lambda a: sentence(f"WIXDR,P,,B,OIL,P,{_bar(a)},B,Barometer"),
    "hpa-labelled-bar": lambda a: sentence(f"IIXDR,P,{a.pressure_hpa:.2f},B,Barometer"),
    "two-barometers": lambda a: (
        sentence(f"WIXDR,P,{_bar(a)},B,Barometer")
        + sentence(f"IIXDR,P,{(a.pressure_hpa - 15.0) / 1000.0:.4f},B,BARO2")
    ),
    "inches-finer": lambda a: sentence(
        f"WIMDA,{a.pressure_hpa / HPA_PER_INHG:.4f},I,{_bar(a, 2)},B,{a.temperature_c:.1f},C"
    ),
    "kelvin": lambda a: sentence(f"WIXDR,C,{a.temperature_c + 273.15:.2f},K,TEMP,P,{_bar(a, 5)},B,Barometer"),
}
