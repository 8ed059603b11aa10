// Keeps the page as the rig is. /status is asked for every few seconds and after each event; where it does not answer,
// the page says so and nothing on it looks current.

import { isCurrent, showAnswer, showPlace } from "./answer.js";
import { allowCapture, prepareCapture } from "./capture.js";
import { $, element, say } from "./dom.js";
import { showFrames } from "./frames.js";
import { loadMap, showOnMap } from "./map.js";
import { clock, count, duration, eventLine } from "./words.js";

const ASK_EVERY_MS = 4000;
const ANSWER_WITHIN_MS = 6000;
const AGAIN_MS = 3000;
const LINES = 100;

let state = null;
let received = null;
let online = false;
let lost = new Date();
let track = [];
let answered = null; // whose track it is; null before the first question, and to have it asked for anew

// The larger of two clocks' times: one of them stops while a phone sleeps, the other may be set back.
function since(moment) {
  return Math.max(0, performance.now() - moment.monotonic, Date.now() - moment.wall) / 1000;
}

const aged = (answer) => answer.age_s + since(received);

async function get(path) {
  const response = await fetch(path, { signal: AbortSignal.timeout(path.startsWith("/map") ? 310000 : ANSWER_WITHIN_MS) });
  if (!response.ok) throw Object.assign(new Error((await response.json()).detail), { status: response.status });
  return response.json();
}

let asking = false;
let again = false;

// One question at a time; what happens meanwhile is answered by the next.
async function refresh() {
  if (asking) {
    again = true;
    return;
  }
  const moment = { monotonic: performance.now(), wall: Date.now() };
  asking = true;
  again = false;
  try {
    state = await get("/status");
    received = moment; // when it was asked: nothing looks younger than it is
    setOnline(true);
    await showState();
  } catch (error) {
    if (error.status === undefined) setOnline(false);
    else say($("frames-say"), error.message);
  } finally {
    asking = false;
  }
  tick();
  if (again && online) refresh();
}

function setOnline(now) {
  if (online && !now) lost = new Date();
  online = now;
  document.body.classList.toggle("offline", !online);
  $("offline").hidden = online;
}

async function showState() {
  showPlace(state);
  showDevices();
  const now = state.last?.bundle ?? "";
  if (now !== answered) {
    track = await get("/track?limit=200");
    answered = now;
  }
  await showFrames(get);
}

// What changes with the seconds.
function tick() {
  if (!online) say($("offline-since"), `for ${duration((Date.now() - lost) / 1000)}: what is shown is old.`);
  if (!state) return;
  showAnswer(state, aged, online);
  allowCapture(state, online);
  const current = state.last !== null && isCurrent(state.last, aged, online);
  showOnMap({ track, last: state.last, lastFix: state.last_fix, current });
  const verdict = $("verdict").textContent;
  document.title = online ? `${verdict} · skyfix` : "no connection · skyfix";
  const doing = state.activity === "capturing" ? `capturing for ${duration(state.activity_for_s + since(received))}` : state.activity;
  const parts = [online ? doing : `${doing} when last heard of`];
  if (state.locating) parts.push(`locating ${state.locating}`);
  if (state.degraded) parts.push("DEGRADED: see the devices");
  say($("activity"), parts.join(" · "));
}

function showDevices() {
  $("devices").replaceChildren(
    ...state.devices.map((device) =>
      element(
        "li",
        {},
        element("span", { class: `state ${device.state}` }, device.state),
        element("span", {}, device.name),
        element("small", {}, device.detail),
      ),
    ),
  );
  const failed = state.counts["captures failed"] ?? 0;
  say(
    $("queue"),
    `${count(state.waiting, "bundle")} to locate; ${count(state.counts["captures done"] ?? 0, "capture")} since the start ` +
      `${duration(state.up_s)} ago${failed ? `, ${failed} failed` : ""}.`,
  );
}

// ---- events and log

let seen = new Set();

// Newest first; the same event comes by /log and by /events.
function note(event) {
  if (seen.has(event.number)) return;
  seen.add(event.number);
  const line = eventLine(event);
  if (!line) return;
  const time = element("time", { datetime: event.at }, clock(event.at));
  const node = element("li", { "data-number": event.number }, time, element("span", { class: line[1] }, line[0]));
  const log = $("log");
  log.insertBefore(node, [...log.children].find((other) => Number(other.dataset.number) < event.number) ?? null);
  while (log.children.length > LINES) log.lastChild.remove();
}

function listen() {
  const source = new EventSource("/events");
  source.onopen = async () => {
    seen = new Set(); // the numbers begin anew with the daemon
    answered = null; // and its spool may know more, or less
    $("log").replaceChildren();
    refresh();
    askForMap();
    try {
      (await get("/log")).forEach(note);
    } catch {
      source.close(); // and all anew
      setTimeout(listen, AGAIN_MS);
    }
  };
  source.onerror = () => {
    refresh();
    // after an answer that is no stream the browser gives up
    if (source.readyState === EventSource.CLOSED) setTimeout(listen, AGAIN_MS);
  };
  for (const kind of ["status", "device", "trigger", "capture", "answer", "log"])
    source.addEventListener(kind, (message) => {
      note(JSON.parse(message.data));
      if (kind !== "log") refresh();
    });
}

let mapAsked = false;

// Anew with each connection: the rig may have been given another elevation model.
async function askForMap() {
  if (mapAsked) return;
  mapAsked = true;
  try {
    await loadMap(get);
  } catch (error) {
    say($("map-says"), error.message);
    setTimeout(askForMap, 10 * AGAIN_MS);
  } finally {
    mapAsked = false;
  }
}

prepareCapture();
$("lines").onchange = () => $("frames").classList.toggle("no-lines", !$("lines").checked);
refresh();
listen();
setInterval(refresh, ASK_EVERY_MS);
setInterval(tick, 1000);
document.addEventListener("visibilitychange", () => document.hidden || refresh());
