// The page of a running bridge: packets come in over a WebSocket, and what changed is drawn once a frame.

import { drawBeams } from "./beams.js";
import { byId } from "./elements.js";
import { drawNumbers } from "./numbers.js";
import { forgetOld, state, take } from "./state.js";
import { drawStrips } from "./strips.js";

const RETRY_MS = 500;  // time between two tries to reach the bridge's page process
window.drawn = { timeS: 0, echoS: 0, atMs: 0 };  // the newest packet and echo on the screen, and since when

let isDue = false;
function draw() {
  isDue = false;
  drawNumbers();
  if (!state.airframe) return;
  forgetOld();
  drawBeams();
  drawStrips();
  window.drawn = { timeS: state.nowS, echoS: state.echoS, atMs: performance.timeOrigin + performance.now() };
}

function drawSoon() {
  if (!isDue) { isDue = true; requestAnimationFrame(draw); }
}

let connection = null;
function connect() {
  connection = new WebSocket(`${location.origin.replace(/^http/, "ws")}/live${location.search}`);
  connection.onmessage = (event) => { JSON.parse(event.data).forEach(take); drawSoon(); };
  connection.onopen = () => { byId("add-mark").disabled = state.offline = false; };
  connection.onclose = () => {
    byId("add-mark").disabled = state.offline = true;
    drawSoon();
    setTimeout(connect, RETRY_MS);
  };
}

byId("mark-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const field = byId("mark");
  const text = field.value.trim();
  if (!text) return;
  connection.send(JSON.stringify({ mark: text }));
  byId("marked").textContent = `marked: ${text}`;
  field.value = "";
});
window.addEventListener("resize", drawSoon);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawSoon);
drawSoon();
connect();
