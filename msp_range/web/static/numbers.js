// The page's numbers and lists: distance, air, link, what is wrong, the texts to the pilot.

import { byId, made, metres } from "./elements.js";
import { OLD_S, presentDistance, state } from "./state.js";

export function drawNumbers() {
  const { airframe, status } = state;
  const badge = byId("state");
  const shown = state.gone ? "gone" : status?.state ?? "waiting";
  badge.dataset.state = shown;
  badge.textContent = { gone: "the bridge does not run", waiting: "waiting for the bridge" }[shown] ?? shown;
  drawFaults(state.gone ? [] : status?.faults ?? []);
  if (!airframe) return;
  byId("vehicle").textContent = document.title = airframe.vehicle;
  const distance = presentDistance();
  byId("distance").textContent = state.gone ? "–" : distance ? metres(distance.range_m) : "no distance";
  byId("distance-more").textContent = !distance ? "" : (airframe.sends_nothing ? "not sent; " : "") +
    `deviation ${(100 * Math.sqrt(distance.variance_m2)).toFixed(1)} cm, climbing ${distance.climb_m_s.toFixed(1)} m/s, ` +
    `slope ${(180 / Math.PI * Math.atan(Math.hypot(distance.rise_north, distance.rise_east))).toFixed(0)} deg`;
  if (!status) return;
  // The rows of msp_range/watch/facts.py, which the bridge sends with its status.
  const facts = [
    ...status.facts.filter((fact) => fact.in_list).map(({ name, text }) => [name, text.replace(/^:? /, "")]),
    ["it received", received()],
    ["running for", duration(status.uptime_s)],
  ];
  byId("facts").replaceChildren(...facts.flatMap(([name, text]) => [made("dt", name), made("dd", text)]));
  byId("texts").replaceChildren(...state.texts.toReversed().map(
    (each) => made("li", `${duration(state.nowS - each.timeS)} ago: ${each.text}`, each.severity)));
}

// What is wrong: causes with what to do, and behind each what follows from it. Drawn when it changes, since it is read
// aloud then.
let shownFaults = "[]";
function drawFaults(faults) {
  if (shownFaults === JSON.stringify(faults)) return;
  shownFaults = JSON.stringify(faults);
  byId("wrong").hidden = !faults.length;
  byId("faults").replaceChildren(...faults.map((each) => {
    const line = made("li", each.text, each.cause === null ? each.severity : "follows");
    if (each.cause === null) line.append(made("small", each.remedy));
    return line;
  }));
}

function received() {
  const fresh = Object.values(state.autopilot).filter((each) => state.nowS - each.timeS < 3 * OLD_S);
  const lines = fresh.map((each) => each.kind === "SYS_STATUS" ?
    `range finder ${each.healthy ? "healthy" : each.present ? "not healthy" : "not present"}` :
    `${metres(each.distance_m)}, orientation ${each.orientation}`);
  return lines.length ? lines.join("; ") : "not said";
}

function duration(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  if (whole < 60) return `${whole} s`;
  return whole < 3600 ? `${Math.floor(whole / 60)} min ${whole % 60} s` :
    `${Math.floor(whole / 3600)} h ${Math.floor(whole % 3600 / 60)} min`;
}
