// The latest bundle's frames with the skylines over them.

import { $, element, say, svg } from "./dom.js";
import { clock } from "./words.js";

let shown = "";

export async function showFrames(get) {
  const [newest] = (await get("/bundles?limit=4")).filter((bundle) => bundle.here);
  if (!newest) return;
  const state = `${newest.id} ${newest.state} ${newest.status}`;
  if (state === shown) return;
  const located = newest.state === "located";
  const [document, lines, answer] = await Promise.all([
    get(`/bundles/${newest.id}`),
    located ? get(`/bundles/${newest.id}/skylines`).catch(missing) : null,
    located ? get(`/bundles/${newest.id}/fix`).catch(missing) : null,
  ]);
  shown = state;
  const { width_px, height_px } = document.camera;
  $("frames").replaceChildren(
    ...document.frames.map((frame) => {
      const over = lines?.frames.find((each) => each.label === frame.label);
      const address = `/bundles/${newest.id}/frames/${frame.file.split("/").at(-1)}`;
      const residual = answer?.fix.residual[frame.label];
      return element(
        "figure",
        {},
        svg(
          "svg",
          { viewBox: `-0.5 -0.5 ${width_px} ${height_px}`, role: "img", "aria-label": `Frame ${frame.label}` },
          svg("image", { href: address, x: -0.5, y: -0.5, width: width_px, height: height_px }),
          ...["found", "doubtful", "predicted"].map((kind) => svg("path", { class: kind, d: pathOf(over?.[kind] ?? []) })),
        ),
        element(
          "figcaption",
          {},
          element("b", {}, frame.label),
          `${((frame.azimuth_deg + 0.05) % 360 - 0.05).toFixed(1).replace("-0.0", "0.0")}°${residual === undefined ? "" : `, residual ${residual.toFixed(1)} px`}`,
        ),
      );
    }),
  );
  const became = { waiting: "not located yet", failed: `not located: ${newest.reason}`, located: newest.status };
  say($("frames-say"), `Taken ${clock(document.created)} UTC: ${became[newest.state] === "none" ? "no fix" : became[newest.state]}`);
}

// What is not there is shown without; anything else is the caller's.
function missing(error) {
  if (error.status !== 404) throw error;
  return null;
}

function pathOf(lines) {
  return lines.map((line) => `M${line.map(([u, v]) => `${u} ${v}`).join("L")}`).join("");
}
