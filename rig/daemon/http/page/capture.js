// The one thing that the page can do, for whoever has the token.

import { $, say } from "./dom.js";

const KEPT = "skyfix token";
let canAct = false;

export function allowCapture(state, online) {
  canAct = state.can_act;
  const button = $("capture");
  button.disabled = !online || !canAct || state.activity !== "idle";
  button.title = canAct ? "" : "Nothing can be done over HTTP: [run.http] token_file is not configured";
}

export function prepareCapture() {
  $("capture").onclick = () => (sessionStorage.getItem(KEPT) ? capture() : ask(""));
  $("ask").addEventListener("close", () => {
    const token = $("token").value.trim();
    $("token").value = "";
    if ($("ask").returnValue !== "ok" || !token) return;
    sessionStorage.setItem(KEPT, token);
    capture();
  });
}

function ask(why) {
  if (why) say($("ask-why"), why);
  $("ask").returnValue = "";
  $("ask").showModal();
  $("token").focus();
}

async function capture() {
  tell("asking …", false);
  try {
    const headers = { Authorization: `Bearer ${sessionStorage.getItem(KEPT)}` };
    const response = await fetch("/capture", { method: "POST", headers, signal: AbortSignal.timeout(8000) });
    if (response.status === 401) {
      sessionStorage.removeItem(KEPT);
      tell("", false);
      ask("This token was refused. It has to be exactly what is in the file.");
      return;
    }
    const { detail } = await response.json();
    tell(response.ok ? "A capture has begun." : detail, !response.ok);
  } catch (error) {
    tell(`The rig did not answer: ${error.message}`, true);
  }
}

let fading = 0;

function tell(text, bad) {
  say($("capture-says"), text);
  $("capture-says").className = bad ? "bad" : "";
  clearTimeout(fading);
  fading = setTimeout(() => say($("capture-says"), ""), 10000);
}
