// The position and how far it is to be trusted. An old fix never looks like a current one.

import { $, element, say } from "./dom.js";
import { SIGMAS_95, axes, count, duration, grid, heading, latLon, metres } from "./words.js";

const VERDICT = { fix: "FIX", ambiguous: "AMBIGUOUS", none: "NO FIX" };

// `aged` tells how old an answer is at this moment.
export function isCurrent(answer, aged, online) {
  return online && answer.current && aged(answer) <= answer.valid_s;
}

export function showAnswer(state, aged, online) {
  const box = $("answer");
  const last = state.last;
  if (!last) {
    box.className = "wait";
    say($("verdict"), "NO ANSWER YET");
    say($("age"), "");
    say($("meaning"), `Nothing has been located yet; the rig was started ${duration(state.up_s)} ago.`);
    return;
  }
  const status = last.fix.status;
  const old = status === "fix" ? !isCurrent(last, aged, online) : last.before_start;
  box.className = old ? "old" : status;
  say($("verdict"), old ? `OLD ${status === "fix" ? "" : "ANSWER: "}${VERDICT[status]}` : VERDICT[status]);
  say($("age"), `${duration(aged(last))} old`);
  say($("meaning"), meaning(state, status, old, aged, online));
}

function meaning(state, status, old, aged, online) {
  const before = state.last_fix;
  const since = before && status !== "fix" ? ` The last fix is ${duration(aged(before))} old: the vehicle may be elsewhere now.` : "";
  if (status === "ambiguous") {
    const places = state.last.fix.candidates.length;
    return (places > 1 ? `${count(places, "place")} fit: none of them is to be trusted alone.` : "One place fits, but it is poorly known.") + since;
  }
  if (status === "none") return `The frames fit no place in this elevation model.${since}`;
  if (!online) return "Without a connection nobody knows whether it still holds.";
  if (old && state.last.before_start)
    return "Here the vehicle was before the rig was started anew: nobody has watched since whether it moved.";
  if (old && state.last.moved_on) return "Here the vehicle was then: it has been seen to move since.";
  if (old) return `Here the vehicle was then. It counts as current for ${duration(state.valid_s)}.`;
  return "";
}

// What does not change with the seconds.
export function showPlace(state) {
  const last = state.last;
  const fix = last?.fix;
  const shown = fix?.status === "fix";
  $("place").replaceChildren(...(shown ? latLon(fix.position).flatMap((text) => [element("span", {}, text), " "]) : []));
  $("candidates").hidden = fix?.status !== "ambiguous";
  $("facts").hidden = fix?.status === "ambiguous";
  $("facts").replaceChildren(...(last ? facts(last) : []));
  $("candidates").replaceChildren(...(fix?.status === "ambiguous" ? fix.candidates.slice(0, 8).map(candidate) : []));
}

function facts({ fix, altitude_m, vehicle_heading_deg, vehicle_heading_sigma_deg, mode, bundle }) {
  const out = [];
  if (fix.status === "fix") {
    const { major } = axes(fix.covariance_m2);
    out.push(["95 % within", metres(SIGMAS_95 * major)]);
    out.push(["camera's altitude", altitude_m === null ? "unknown" : metres(altitude_m)]);
    if (vehicle_heading_deg !== null) out.push(["heading", `${heading(vehicle_heading_deg)} ± ${vehicle_heading_sigma_deg.toFixed(1)}°`]);
    out.push([fix.position.crs.length < 16 ? fix.position.crs : "grid", grid(fix.position)]);
    out.push(["probability", fix.probability.toFixed(3)]);
  }
  out.push(["searched", mode], ["bundle", bundle]);
  return out.map(([name, value]) => element("div", { class: value.length > 11 ? "wide" : "" }, element("dt", {}, name), element("dd", {}, value)));
}

function candidate(place, i) {
  const bar = element("span");
  bar.style.width = `${100 * place.probability}%`;
  return element(
    "li",
    {},
    element("b", {}, String(i + 1)),
    element("i", { "aria-hidden": "true" }, bar),
    element("span", {}, `${(100 * place.probability).toFixed(place.probability < 0.1 ? 1 : 0)} %`),
    element("span", {}, grid(place)),
  );
}
