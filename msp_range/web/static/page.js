// The page of a running bridge: packets come in over a WebSocket, and what changed is drawn once a frame.
"use strict";

const SHOWN_S = 30;          // width of a strip [s]
const OLD_S = 2;             // a range or a distance that is older is not shown as the present one [s]
const RETRY_MS = 500;        // time between two tries to reach the bridge's page process
const TEXTS = 30;            // reports to the pilot that are listed

const state = {
  airframe: null, status: null, attitude: null, fused: null, autopilot: {}, texts: [],
  readings: {}, lines: [], nowS: 0, echoS: 0, gone: true,
};
window.drawn = { timeS: 0, echoS: 0, atMs: 0 };  // the newest packet and echo on the screen, and since when

const byId = (id) => document.getElementById(id);
const words = (code) => code.replaceAll("_", " ");
const metres = (value) => `${value.toFixed(2)} m`;

function take({ topic, time_s: timeS, message }) {
  if (topic === "/gone") { state.gone = true; return; }
  state.gone = false;
  state.nowS = Math.max(state.nowS, timeS);
  if (topic.startsWith("/range/")) {
    const list = state.readings[topic.slice(7)] ??= [];
    list.push({ timeS, ...message });
    state.echoS = message.time_s;
  } else if (topic === "/fused") {
    state.fused = { timeS, ...message };
    state.lines.push({ timeS, rangeM: message.range_m });
  } else if (topic === "/attitude") state.attitude = message;
  else if (topic === "/status") state.status = message;
  else if (topic === "/autopilot") state.autopilot[message.kind + (message.orientation ?? "")] = { timeS, ...message };
  else if (topic === "/health" || topic === "/mark") {
    const severity = topic === "/mark" ? "mark" : message.severity;
    state.texts.push({ timeS, severity, text: topic === "/mark" ? `mark: ${message.text}` : message.text });
    state.texts.splice(0, state.texts.length - TEXTS);
  } else if (topic === "/airframe") {
    Object.assign(state, { airframe: message, status: null, fused: null, attitude: null, autopilot: {}, texts: [],
      readings: {}, lines: [], nowS: timeS });
    makeStrips();
  }
}

function forgetOld() {
  const first = state.nowS - SHOWN_S;
  for (const list of [...Object.values(state.readings), state.lines]) {
    const keep = list.findIndex((each) => each.timeS >= first);
    list.splice(0, keep < 0 ? list.length : keep);
  }
}

// ---------------------------------------------------------------- what a reading is

function kindOf(reading) {
  if (reading.status !== "ok") return "nothing";
  return reading.rejected ? "rejected" : "used";
}

function reasonOf(reading) {
  return reading.status !== "ok" ? words(reading.status) : reading.rejected ? words(reading.rejected) : "";
}

function newest(name) {
  const list = state.readings[name];
  const last = list && list[list.length - 1];
  return last && state.nowS - last.timeS < OLD_S ? last : null;
}

function presentDistance() {
  return state.fused && state.nowS - state.fused.timeS < OLD_S ? state.fused : null;
}

function faultOf(name) {
  return state.status?.sensors[name]?.fault ?? null;
}

// ---------------------------------------------------------------- numbers and lists

function drawNumbers() {
  const { airframe, status } = state;
  const badge = byId("state");
  const shown = state.gone ? "gone" : status?.state ?? "waiting";
  badge.dataset.state = shown;
  badge.textContent = { gone: "the bridge does not run", waiting: "waiting for the bridge" }[shown] ?? shown;
  if (!airframe) return;
  byId("vehicle").textContent = document.title = airframe.vehicle;
  const distance = presentDistance();
  byId("distance").textContent = state.gone ? "–" : distance ? metres(distance.range_m) : "no distance";
  byId("distance-more").textContent = !distance ? "" :
    `deviation ${(100 * Math.sqrt(distance.variance_m2)).toFixed(1)} cm, climbing ${distance.climb_m_s.toFixed(1)} m/s, ` +
    `slope ${(180 / Math.PI * Math.atan(Math.hypot(distance.rise_north, distance.rise_east))).toFixed(0)} deg`;
  if (!status) return;
  const { air, link } = status;
  const facts = [
    ["air", `${air.temperature_c.toFixed(1)} C ± ${air.std_c.toFixed(1)}, from ${air.source}`],
    ["link", link.connected ? link.url : `${link.url}: ${link.error ?? "not connected"}`],
    ["autopilot", link.autopilot === null ? "none received" : `system ${link.autopilot}, ${link.armed ? "armed" : "disarmed"}`],
    ["sent", `${link.sent.DISTANCE_SENSOR ?? 0} distances, ${link.dropped} frames dropped`],
    ["it received", received()],
    ["recording", status.recording ?? "none"],
    ["running for", duration(status.uptime_s)],
  ];
  byId("facts").replaceChildren(...facts.flatMap(([name, text]) => [made("dt", name), made("dd", text)]));
  const faults = status.faults.map((each) => made("li", each.text, each.severity));
  byId("faults").replaceChildren(...(faults.length ? faults : [made("li", "nothing")]));
  byId("texts").replaceChildren(...state.texts.toReversed().map(
    (each) => made("li", `${duration(state.nowS - each.timeS)} ago: ${each.text}`, each.severity)));
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

function made(tag, text, className = "") {
  const element = document.createElement(tag);
  element.textContent = text;
  element.className = className;
  return element;
}

// ---------------------------------------------------------------- beams from above and from the side

function halfAngle(sensor, rangeM) {
  const table = sensor.half_angle_deg;
  const after = table.findIndex(([range]) => range >= rangeM);
  if (after === 0) return table[0][1];
  if (after < 0) return table[table.length - 1][1];
  const [[r0, a0], [r1, a1]] = [table[after - 1], table[after]];
  return a0 + (a1 - a0) * (rangeM - r0) / (r1 - r0);
}

// What of a sensor is drawn: how far its beam reaches now, how wide it is there, and its class.
function beamOf(sensor) {
  const reading = newest(sensor.name);
  const hasRange = reading && reading.corrected_m !== undefined;
  const rangeM = hasRange ? reading.corrected_m : Math.min(sensor.maximum_m, reach());
  const radiusM = rangeM * Math.tan(halfAngle(sensor, rangeM) * Math.PI / 180);
  const kind = faultOf(sensor.name) || !reading ? "faulty" : hasRange ? kindOf(reading) : "nothing";
  const [x, y, z] = sensor.position_m;
  const [bx, by, bz] = sensor.boresight;
  return { sensor, kind, rangeM, radiusM, start: [x, y, z], end: [x + bx * rangeM, y + by * rangeM, z + bz * rangeM],
    axis: [bx, by, bz] };
}

// A length for beams without a range: the distance down, or the longest that is shown, or 2 m.
function reach() {
  const known = state.airframe.sensors.map((each) => newest(each.name)?.corrected_m).filter((each) => each !== undefined);
  return presentDistance()?.range_m ?? (known.length ? Math.max(...known) : 2);
}

function niceLength(lengthM) {
  const power = 10 ** Math.floor(Math.log10(lengthM));
  return [5, 2, 1].map((each) => each * power).find((each) => each <= lengthM);
}

function svg(tag, attributes, text) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

// Zoom grows at once and shrinks in steps of a fifth, so that the picture does not breathe with every reading.
const zooms = {};
function zoomed(id, sizeM) {
  const kept = zooms[id];
  if (kept === undefined || sizeM > kept || sizeM < 0.7 * kept) zooms[id] = 1.2 * sizeM;
  return zooms[id];
}

// Draws shapes in metres into a picture: u to the right, v downwards, both around the middle (cu, cv).
function drawing(id, halfU, halfV, cu, cv) {
  const picture = byId(id);
  const { width, height } = picture.getBoundingClientRect();
  const scale = Math.min(width / (2 * halfU), height / (2 * halfV));
  picture.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const at = (u, v) => [width / 2 + (u - cu) * scale, height / 2 + (v - cv) * scale];
  return { picture, width, height, scale, at };
}

function scaleBar({ width, height, scale }) {
  const lengthM = niceLength(0.3 * width / scale);
  const [x, y] = [8, height - 8];
  return [svg("line", { class: "scale", x1: x, y1: y, x2: x + lengthM * scale, y2: y }),
    svg("text", { x, y: y - 4 }, `${lengthM} m`)];
}

function drawAbove(beams) {
  const spans = beams.flatMap(({ start, end, radiusM }) =>
    [Math.abs(start[0]), Math.abs(start[1]), Math.abs(end[0]) + radiusM, Math.abs(end[1]) + radiusM]);
  const halfM = zoomed("above", Math.max(0.1, ...spans));
  const on = drawing("above", halfM, halfM, 0, 0);
  const corners = beams.map(({ start }) => start);
  const shapes = [outline(on, corners.map(([x, y]) => on.at(y, -x)))];
  for (const { sensor, kind, radiusM, start, end } of beams) {
    const [cx, cy] = on.at(end[1], -end[0]);
    const [sx, sy] = on.at(start[1], -start[0]);
    shapes.push(svg("circle", { class: `beam ${kind}`, cx, cy, r: Math.max(radiusM * on.scale, 2), "data-sensor": sensor.name }));
    if (Math.hypot(cx - sx, cy - sy) > 3) shapes.push(svg("line", { class: `beam ${kind}`, x1: sx, y1: sy, x2: cx, y2: cy }));
  }
  shapes.push(...labels(beams.map(({ sensor, kind, start, end }) => {
    const [x, y] = on.at((start[1] + end[1]) / 2, -(start[0] + end[0]) / 2);
    return { x, y, kind, text: sensor.name };
  }), on));
  on.picture.replaceChildren(...shapes, ...scaleBar(on));
}

// Names do not cover each other: one that would is moved below the one before.
function labels(wanted, { width }) {
  const placed = [];
  for (const { x, y, kind, text } of wanted) {
    const half = 3.2 * text.length;
    const place = { x: Math.min(Math.max(x, half + 2), width - half - 2), y: y - 4, half };
    while (placed.some((each) => Math.abs(each.x - place.x) < each.half + half && Math.abs(each.y - place.y) < 12)) place.y += 12;
    placed.push(place);
    place.element = svg("text", { x: place.x, y: place.y, "text-anchor": "middle", class: kind }, text);
  }
  return placed.map((each) => each.element);
}

function outline(on, points) {
  const [us, vs] = [points.map(([u]) => u), points.map(([, v]) => v)];
  const pad = 4;
  return svg("rect", { class: "pallet", x: Math.min(...us) - pad, y: Math.min(...vs) - pad, rx: 3,
    width: Math.max(...us) - Math.min(...us) + 2 * pad, height: Math.max(...vs) - Math.min(...vs) + 2 * pad });
}

function drawSide(beams) {
  const distance = presentDistance();
  const referenceM = state.airframe.reference_down_m;
  const groundM = distance && referenceM !== null ? referenceM + distance.range_m : null;
  const us = beams.flatMap(({ start, end, radiusM }) => [start[0], end[0] - radiusM, end[0] + radiusM]);
  const vs = beams.flatMap(({ start, end }) => [start[2], end[2]]).concat(groundM ?? []);
  const [lowU, highU, lowV, highV] = [Math.min(...us), Math.max(...us), Math.min(...vs, 0), Math.max(...vs)];
  const halfM = zoomed("side", Math.max(0.1, (highU - lowU) / 2, (highV - lowV) / 2 + 0.05));
  const on = drawing("side", halfM, halfM, (lowU + highU) / 2, (lowV + highV) / 2);
  const shapes = [outline(on, beams.map(({ start }) => on.at(start[0], start[2])))];
  for (const { sensor, kind, radiusM, start, end, axis } of beams) {
    // Across the beam, in the plane of the picture.
    const length = Math.hypot(axis[0], axis[2]) || 1;
    const [du, dv] = [-axis[2] / length * radiusM, axis[0] / length * radiusM];
    const points = [on.at(start[0], start[2]), on.at(end[0] + du, end[2] + dv), on.at(end[0] - du, end[2] - dv)];
    shapes.push(svg("polygon", { class: `beam ${kind}`, points: points.join(" "), "data-sensor": sensor.name }));
  }
  if (groundM !== null) {
    const slope = groundSlope(distance);
    const [x1, y1] = on.at(lowU - halfM, groundM + slope * (lowU - halfM));
    const [x2, y2] = on.at(highU + halfM, groundM + slope * (highU + halfM));
    shapes.push(svg("line", { class: "ground", x1, y1, x2, y2 }));
  }
  on.picture.replaceChildren(...shapes, ...scaleBar(on));
}

// How much farther down the ground is for each metre forward, in the vehicle's own axes.
function groundSlope({ rise_north: north, rise_east: east }) {
  if (!state.attitude) return -north;
  const { pitch_rad: pitch, yaw_rad: yaw } = state.attitude;
  return Math.tan(pitch) - (north * Math.cos(yaw) + east * Math.sin(yaw));
}

// ---------------------------------------------------------------- strips

function makeStrips() {
  const strips = state.airframe.sensors.map((sensor) => strip(sensor.name));
  if (state.airframe.reference_down_m !== null) strips.unshift(strip("distance down", true));
  byId("strips").replaceChildren(...strips);
  byId("filtered-key").hidden = !state.airframe.sensors.some((sensor) => sensor.has_stream);
}

function strip(name, isFused = false) {
  const row = made("div", "", "strip");
  row.dataset.strip = name;
  if (isFused) row.dataset.fused = "yes";
  const left = made("div", "");
  left.append(made("p", name), made("p", "", "more"));
  const canvas = document.createElement("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${name}, last ${SHOWN_S} s`);
  row.append(left, canvas);
  return row;
}

function drawStrips() {
  const style = getComputedStyle(document.documentElement);
  const colour = Object.fromEntries(["used", "filtered", "rejected", "nothing", "soft", "line"].map(
    (each) => [each, style.getPropertyValue(`--${each}`)]));
  const highest = 1.1 * Math.max(1, ...Object.values(state.readings).flat().map((each) => each.corrected_m ?? 0),
    ...state.lines.map((each) => each.rangeM));
  for (const row of byId("strips").children) {
    const name = row.dataset.strip;
    const canvas = row.querySelector("canvas");
    const on = plot(canvas, highest, colour);
    if (row.dataset.fused) {
      on.line(state.lines.map(({ timeS, rangeM }) => [timeS, rangeM]), colour.used);
      row.querySelector(".more").textContent = presentDistance() ? metres(state.fused.range_m) : "no distance";
      continue;
    }
    const readings = state.readings[name] ?? [];
    on.line(readings.filter((each) => each.filtered_m !== undefined).map((each) => [each.timeS, each.filtered_m]), colour.filtered);
    for (const each of readings) on.mark(each, colour);
    const last = newest(name);
    const fault = faultOf(name);
    row.classList.toggle("faulty", fault !== null || !last);
    row.querySelector(".more").textContent = fault ?? (!last ? "no reading" :
      [last.corrected_m !== undefined ? metres(last.corrected_m) : "", reasonOf(last)].filter(Boolean).join(", "));
  }
}

// A canvas with time to the right and range upwards.
function plot(canvas, highest, colour) {
  const ratio = window.devicePixelRatio || 1;
  const { width, height } = canvas.getBoundingClientRect();
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "10px system-ui, sans-serif";
  const left = 34;
  const x = (timeS) => left + (1 - (state.nowS - timeS) / SHOWN_S) * (width - left - 4);
  const y = (rangeM) => 4 + (1 - rangeM / highest) * (height - 12);
  pen.strokeStyle = colour.line;
  pen.fillStyle = colour.soft;
  for (const rangeM of [0, highest]) {
    pen.beginPath();
    pen.moveTo(left, y(rangeM));
    pen.lineTo(width, y(rangeM));
    pen.stroke();
    pen.fillText(`${rangeM.toFixed(rangeM ? 1 : 0)} m`, 0, y(rangeM) + (rangeM ? 8 : 0));
  }
  let lastReason = "";
  let lastX = -1e9;
  return {
    line(points, stroke) {
      pen.strokeStyle = stroke;
      pen.lineWidth = 1.5;
      pen.beginPath();
      let before = -1e9;
      for (const [timeS, rangeM] of points) {
        // Where nothing was known there is no line.
        if (timeS - before > OLD_S) pen.moveTo(x(timeS), y(rangeM)); else pen.lineTo(x(timeS), y(rangeM));
        before = timeS;
      }
      pen.stroke();
    },
    mark(reading, colours) {
      const kind = kindOf(reading);
      const [px, py] = [x(reading.timeS), y(reading.corrected_m ?? 0)];
      pen.fillStyle = pen.strokeStyle = colours[kind];
      pen.lineWidth = 1.5;
      if (kind === "nothing") pen.fillRect(px - 1.5, height - 7, 3, 5);
      else if (kind === "used") { pen.beginPath(); pen.arc(px, py, 2, 0, 7); pen.fill(); }
      else pen.strokeRect(px - 2.5, py - 2.5, 5, 5);
      const reason = reasonOf(reading);
      if (reason && (reason !== lastReason || px - lastX > 120) && px - lastX > 60) {
        pen.fillText(reason, Math.min(px + 4, width - 6 * reason.length), kind === "nothing" ? height - 10 : Math.max(py - 4, 10));
        [lastReason, lastX] = [reason, px];
      }
    },
  };
}

// ---------------------------------------------------------------- the loop

let isDue = false;
function draw() {
  isDue = false;
  drawNumbers();
  if (!state.airframe) return;
  forgetOld();
  const beams = state.airframe.sensors.map(beamOf);
  drawAbove(beams);
  drawSide(beams);
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
  connection.onclose = () => { state.gone = true; drawSoon(); setTimeout(connect, RETRY_MS); };
}

byId("mark-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const field = byId("mark");
  const text = field.value.trim();
  if (!text || connection.readyState !== WebSocket.OPEN) return;
  connection.send(JSON.stringify({ mark: text }));
  byId("marked").textContent = `marked: ${text}`;
  field.value = "";
});
window.addEventListener("resize", drawSoon);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawSoon);
drawSoon();
connect();
