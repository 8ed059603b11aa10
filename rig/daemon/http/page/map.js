// Shaded relief of the whole DEM; over it the track, the fix with its ellipse or the candidates.
// Lengths are metres of the map from the sheet's north-western corner, x to the east, y to the south. What is told or given in
// metres of the ground (ellipses, the scale bar) is turned into these first: a map's metre may be much shorter.

import { $, say, svg } from "./dom.js";
import { SIGMAS_95, axes } from "./words.js";

const STAR = [...Array(10).keys()].map((i) => {
  const r = i % 2 ? 0.45 : 1;
  return `${r * Math.sin((i * Math.PI) / 5)},${-r * Math.cos((i * Math.PI) / 5)}`;
}).join(" ");
const FEWEST_M = { near: 40, track: 3000 };
const SHOWN_OF_TRACK = 30;

let sheet = null;
let wanted = "track"; // a view, or null once somebody has moved the map
let view = null; // {x, y, scale}: centre, metres a pixel
let content = { track: [], last: null, lastFix: null, current: false };

export async function loadMap(get) {
  const now = await get("/map");
  if (now.image === sheet?.image) return;
  const first = sheet === null;
  sheet = now;
  view = null;
  $("map").replaceChildren(
    svg("image", { href: sheet.image, x: 0, y: 0, width: width(), height: height(), preserveAspectRatio: "none" }),
    svg("g", { id: "over" }),
  );
  say($("map-says"), "");
  $("scale").hidden = $("north").hidden = false;
  if (!first) return draw();
  for (const button of document.querySelectorAll("[data-view]")) button.onclick = () => show(button.dataset.view);
  for (const button of document.querySelectorAll("[data-zoom]")) button.onclick = () => zoom(Number(button.dataset.zoom));
  new ResizeObserver(draw).observe($("map"));
  listen($("map"));
  show(wanted);
}

export function showOnMap(next) {
  const changed = Object.keys(next).some((name) => next[name] !== content[name]);
  content = next;
  if (changed) draw();
}

const width = () => sheet.east_m - sheet.west_m;
const height = () => sheet.north_m - sheet.south_m;
const at = (place) => [place.easting_m - sheet.west_m, sheet.north_m - place.northing_m];

// Metres of the map in a metre of the ground at a y.
function scaleAt(y) {
  const steps = sheet.scales.length - 1;
  const place = Math.min(steps, Math.max(0, (y / height()) * steps));
  const before = Math.min(steps - 1, Math.floor(place));
  return sheet.scales[before] + (place - before) * (sheet.scales[before + 1] - sheet.scales[before]);
}

function show(name) {
  wanted = name;
  draw();
}

// The places of the latest answer, else of the last fix.
function places() {
  const answer = content.last?.fix.candidates.length ? content.last : content.lastFix;
  if (!answer || answer.fix.position.crs !== sheet.crs) return null;
  return answer;
}

function fit() {
  const { clientWidth, clientHeight } = $("map");
  const answer = places();
  const points = wanted === "whole" ? [] : answer ? answer.fix.candidates.map(at) : [];
  if (wanted === "near" && answer?.fix.status === "fix") points.splice(0, Infinity, at(answer.fix.position));
  if (wanted === "track") points.push(...content.track.slice(-SHOWN_OF_TRACK).filter((p) => p.crs === sheet.crs).map(at));
  if (!points.length) points.push([0, 0], [width(), height()]);
  const [xs, ys] = [points.map((p) => p[0]), points.map((p) => p[1])];
  const [west, east, north, south] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  let least = FEWEST_M[wanted] ?? 0;
  if (wanted === "near" && answer?.fix.status === "fix") least = Math.max(least, 10 * SIGMAS_95 * axes(answer.fix.covariance_m2).major);
  least *= scaleAt((north + south) / 2);
  const margin = wanted === "whole" ? 1 : 1.3;
  const across = Math.max(margin * (east - west), least);
  const down = Math.max(margin * (south - north), least);
  view = { x: (west + east) / 2, y: (north + south) / 2, scale: Math.max(across / clientWidth, down / clientHeight) };
}

function draw() {
  const { clientWidth, clientHeight } = $("map");
  if (!sheet || !clientWidth || !clientHeight) return;
  if (wanted || !view) fit();
  for (const button of document.querySelectorAll("[data-view]")) button.setAttribute("aria-pressed", button.dataset.view === wanted);
  const { x, y, scale } = view;
  $("map").setAttribute("viewBox", `${x - (scale * clientWidth) / 2} ${y - (scale * clientHeight) / 2} ${scale * clientWidth} ${scale * clientHeight}`);
  $("over").replaceChildren(...drawnTrack(scale), ...drawnPlaces(scale));
  drawScale(scale, clientWidth);
}

function drawnTrack(scale) {
  const points = content.track.filter((point) => point.crs === sheet.crs).map(at);
  const line = points.map((p) => p.join(",")).join(" ");
  return [
    svg("polyline", { class: "track-casing", points: line }),
    svg("polyline", { class: "track", points: line }),
    ...points.map(([cx, cy]) => svg("circle", { class: "stop", cx, cy, r: 4 * scale })),
  ];
}

function drawnPlaces(scale) {
  const answer = places();
  say($("map-key"), key(answer));
  if (!answer) return [];
  if (answer.fix.status === "ambiguous")
    return answer.fix.candidates.slice(0, 8).map((candidate, i) => {
      const [x, y] = at(candidate);
      return svg(
        "g",
        { transform: `translate(${x} ${y}) scale(${scale})` },
        svg("path", { class: "diamond", d: "M0-17 17 0 0 17-17 0Z" }),
        svg("text", { class: "number", "font-size": 17 }, String(i + 1)),
      );
    }).reverse();
  const [x, y] = at(answer.fix.position);
  const { major, minor, angle } = axes(answer.fix.covariance_m2);
  const [[ee, en], [ne, nn]] = answer.map_from_ground;
  const turned = `matrix(${ee} ${-ne} ${-en} ${nn} 0 0) rotate(${(-angle * 180) / Math.PI})`; // y runs to the south
  const parts = [svg("ellipse", { class: "ellipse", rx: SIGMAS_95 * major, ry: SIGMAS_95 * minor, transform: turned })];
  if (answer.vehicle_heading_deg !== null) {
    const onMap = answer.vehicle_heading_deg - answer.convergence_deg;
    parts.push(svg("path", { class: "heading", d: "M0-14V-40M-7-32 0-41 7-32", transform: `scale(${scale}) rotate(${onMap})` }));
  }
  // the star would hide the ellipse in a close view
  const size = (SIGMAS_95 * major * scaleAt(y) > 40 * scale ? 8 : 15) * scale;
  parts.push(svg("polygon", { class: "star", points: STAR, transform: `scale(${size})` }));
  return [svg("g", { class: content.current ? "now" : "past", transform: `translate(${x} ${y})` }, ...parts)];
}

function key(answer) {
  const track = content.track.length > 1 ? "Line: the fixes before. " : "";
  if (!answer) return `${track}No place to show.`;
  if (answer.fix.status === "ambiguous") return `${track}Diamonds: the places that fit, by probability.`;
  const star = content.current ? "Star: the fix" : "Hollow star: an old fix, where the vehicle was then";
  return `${track}${star}; ellipse: 95 %${answer.vehicle_heading_deg === null ? "" : "; arrow: its heading"}.`;
}

function drawScale(mapScale, clientWidth) {
  const scale = mapScale / scaleAt(view.y); // metres of the ground a pixel
  const most = scale * Math.min(160, clientWidth / 3);
  const power = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].map((n) => n * power).find((n) => n <= most);
  $("scale").style.width = `${length / scale}px`;
  say($("scale").firstChild, length >= 1000 ? `${length / 1000} km` : `${length} m`);
}

function zoom(factor, at_x, at_y) {
  if (!view) return;
  const { clientWidth, clientHeight } = $("map");
  const most = (2 * Math.max(width(), height())) / Math.min(clientWidth, clientHeight);
  const scale = Math.min(most, Math.max(0.02, view.scale * factor));
  const dx = (at_x ?? clientWidth / 2) - clientWidth / 2;
  const dy = (at_y ?? clientHeight / 2) - clientHeight / 2;
  view = { x: view.x + dx * (view.scale - scale), y: view.y + dy * (view.scale - scale), scale };
  wanted = null;
  draw();
}

// One finger or the mouse moves the map, two fingers and the wheel zoom.
function listen(map) {
  const down = new Map();
  const spread = () => {
    const [a, b] = [...down.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  map.addEventListener("pointerdown", (event) => {
    map.setPointerCapture(event.pointerId);
    down.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
  });
  map.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before || !view) return;
    const now = { x: event.offsetX, y: event.offsetY };
    if (down.size === 1) {
      view = { ...view, x: view.x - (now.x - before.x) * view.scale, y: view.y - (now.y - before.y) * view.scale };
      wanted = null;
      down.set(event.pointerId, now);
      draw();
    } else {
      const wide = spread();
      down.set(event.pointerId, now);
      const [a, b] = [...down.values()];
      if (spread() > 10) zoom(wide / spread(), (a.x + b.x) / 2, (a.y + b.y) / 2);
    }
  });
  for (const end of ["pointerup", "pointercancel"]) map.addEventListener(end, (event) => down.delete(event.pointerId));
  map.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(event.deltaY / 400), event.offsetX, event.offsetY);
  }, { passive: false });
}
