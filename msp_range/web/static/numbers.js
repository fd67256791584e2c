// The page's numbers and lists: distance, air, link, what is wrong, the texts to the pilot.

import { byId, made, metres, rounded } from "./elements.js";
import { OLD_S, isLive, presentDistance, state } from "./state.js";

// What a state means, where nothing is wrong.
const MEANS = {
  active: "Distances go out, the autopilot is received.",
  starting: "Not all sensors and the autopilot are known yet.",
  waiting: "The bridge has not sent its state yet.",
};
const OFFLINE = { text: "This page has lost its connection.", severity: "error", cause: null,
  remedy: "Is this device in the vehicle's network, and its computer on? The page tries again by itself." };

export function drawNumbers() {
  const { airframe, status } = state;
  const badge = byId("state");
  const shown = state.offline ? "offline" : state.gone ? "gone" : status?.state ?? "waiting";
  badge.dataset.state = shown;
  badge.textContent = { offline: "no connection", gone: "the bridge does not run" }[shown] ?? shown;
  const faults = state.offline ? [OFFLINE] : state.gone ?? status?.faults ?? [];
  drawFaults(faults.length ? faults : [{ text: MEANS[shown], severity: "fine", cause: null }]);
  if (!airframe) return;
  byId("vehicle").textContent = document.title = airframe.vehicle;
  const distance = presentDistance();
  byId("facts-section").hidden = !isLive();
  byId("now").hidden = airframe.reference_down_m === null;
  byId("distance").textContent = distance ? metres(distance.range_m) : "none";
  byId("distance-more").textContent = !distance ? "" : (airframe.sends_nothing ? "not sent; " : "") +
    `deviation ${rounded(100 * Math.sqrt(distance.variance_m2), 1)} cm, climb ${rounded(distance.climb_m_s, 1)} m/s`;
  if (!status) return;
  // The rows of msp_range/watch/facts.py, which the bridge sends with its status.
  const facts = [
    ...status.facts.filter((fact) => fact.in_list).map(({ name, text }) => [name, text.replace(/^:? /, "")]),
    ["it received", received()],
    ["ground", distance ? `slope ${rounded(slopeDeg(distance), 0)} deg` : "not known"],
    ["running for", duration(status.uptime_s)],
  ];
  byId("facts").replaceChildren(...facts.flatMap(([name, text]) => [made("dt", name), made("dd", text)]));
  byId("texts").replaceChildren(...state.texts.toReversed().map(
    (each) => made("li", `${duration(state.nowS - each.timeS)} ago: ${each.text}`, each.severity)));
}

const slopeDeg = ({ rise_north: north, rise_east: east }) => 180 / Math.PI * Math.atan(Math.hypot(north, east));

// What is wrong: the first cause with what to do, and on demand what follows from it and the others. Drawn when it
// changes, since it is read aloud then.
byId("more").open = matchMedia("(min-width: 60rem)").matches;
let shownFaults = "";
function drawFaults(faults) {
  if (shownFaults === JSON.stringify(faults)) return;
  shownFaults = JSON.stringify(faults);
  const lines = faults.map((each) => {
    const line = made("li", each.text, each.cause === null ? each.severity : "follows");
    if (each.cause === null && each.remedy) line.append(made("small", each.remedy));
    return line;
  });
  byId("faults").replaceChildren(...lines.splice(0, 1));
  byId("more").hidden = !lines.length;
  byId("more").querySelector("summary").textContent = `${lines.length} more`;
  byId("more-faults").replaceChildren(...lines);
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
