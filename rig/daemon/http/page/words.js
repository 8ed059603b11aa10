// How things are said.

export function duration(seconds) {
  const s = Math.max(0, seconds);
  if (s < 90) return count(Math.floor(s), "second");
  if (s < 5400) return count(Math.floor(s / 60), "minute");
  if (s < 129600) return count(Math.floor(s / 3600), "hour");
  return count(Math.floor(s / 86400), "day");
}

export function count(n, what) {
  return `${n} ${what}${n === 1 ? "" : "s"}`;
}

export function latLon(position) {
  const half = (value, plus, minus) => `${Math.abs(value).toFixed(5)}° ${value >= 0 ? plus : minus}`;
  return [half(position.lat_deg, "N", "S"), half(position.lon_deg, "E", "W")];
}

function grouped(value) {
  return Math.round(value).toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

export function grid({ easting_m, northing_m }) {
  return `${grouped(easting_m)}\u00a0E, ${grouped(northing_m)}\u00a0N`;
}

export function metres(value) {
  return value < 10 ? `${value.toFixed(1)} m` : value < 10000 ? `${Math.round(value)} m` : `${(value / 1000).toFixed(1)} km`;
}

const COMPASS = ["N", "NNE", "NE", "ENE", "E", "ESE", "SE", "SSE", "S", "SSW", "SW", "WSW", "W", "WNW", "NW", "NNW"];

export function heading(deg) {
  return `${Math.round(deg) % 360}° ${COMPASS[Math.round(deg / 22.5) % 16]}`;
}

export function clock(iso) {
  return iso.slice(11, 19);
}

// Of one standard deviation; the angle of the longer axis is counted from east towards north.
export function axes([[ee, en], [, nn]]) {
  const mean = (ee + nn) / 2;
  const off = Math.hypot((ee - nn) / 2, en);
  return { major: Math.sqrt(mean + off), minor: Math.sqrt(Math.max(0, mean - off)), angle: Math.atan2(2 * en, ee - nn) / 2 };
}

export const SIGMAS_95 = Math.sqrt(5.991);

// One line of the log, or null for what it does not show: [text, class].
export function eventLine({ kind, data }) {
  if (kind === "device") return [`${data.name}: ${data.state}${data.detail ? `, ${data.detail}` : ""}`, data.state === "failing" ? "bad" : ""];
  if (kind === "answer") {
    const said = { fix: "fix", ambiguous: "ambiguous: several places fit", none: "no fix: no place fits" }[data.status];
    return [`${said} (${data.bundle}, ${data.mode})`, { fix: "", ambiguous: "warn", none: "bad" }[data.status]];
  }
  if (kind === "trigger") {
    const refused = data.answer && data.answer !== "started";
    return [`trigger (${data.source}): ${data.answer}${data.why ? `, ${data.why}` : ""}`, refused ? "warn" : ""];
  }
  if (kind === "capture") {
    const { stage, reason, bundle } = data;
    const bad = reason !== undefined;
    return [`capture ${stage ?? ""}${bundle ? ` ${bundle}` : ""}${reason ? `: ${reason}` : ""}`, bad ? "bad" : ""];
  }
  if (kind === "log") {
    if (data.level === "info" || data.level === "debug") return null; // said by the other kinds already
    return [data.text ?? JSON.stringify(data), data.level === "warning" ? "warn" : "bad"];
  }
  if (data.activity) return ["idle", "capturing"].includes(data.activity) ? null : [data.activity, ""]; // as above
  if (data.configuration) return [`configuration ${data.configuration}${data.reason ? `: ${data.reason}` : ""}`, data.reason ? "bad" : ""];
  return null;
}
