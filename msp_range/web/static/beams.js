// The beams from above and from the side, to scale.

import { byId } from "./elements.js";
import { faultOf, kindOf, newest, presentDistance, state } from "./state.js";

export function drawBeams() {
  const beams = state.airframe.sensors.map(beamOf);
  drawAbove(beams);
  drawSide(beams);
}

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

function scaleBar({ width, scale }, bottom) {
  const lengthM = niceLength(0.3 * width / scale);
  const [x, y] = [4, bottom];
  return [svg("line", { class: "scale", x1: x, y1: y, x2: x + lengthM * scale, y2: y }),
    svg("text", { class: "length", x, y: y - 6 }, `${lengthM} m`)];
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
  on.picture.replaceChildren(...shapes, ...scaleBar(on, on.height - 4));
  nameBeams(on, beams);
}

// Writes each sensor's name where its beam is farthest from the middle; one that would cover another text moves to the
// nearest free line.
function nameBeams({ picture, width, height, at, scale }, beams) {
  const taken = [...picture.querySelectorAll("text")].map((each) => each.getBBox());
  for (const { sensor, kind, radiusM, start, end } of beams) {
    const [forward, right] = [start[0] + end[0], start[1] + end[1]];
    const length = Math.hypot(forward, right) || 1;
    const [x, y] = at(end[1], -end[0]);
    const text = svg("text", { class: kind, "text-anchor": "middle" }, sensor.name);
    picture.append(text);
    const size = text.getBBox();
    const box = { width: size.width, height: size.height,
      x: x + right / length * radiusM * scale - size.width / 2, y: y - forward / length * radiusM * scale - size.height / 2 };
    box.x = Math.max(0, Math.min(width - box.width, box.x));
    box.y = freeLine(box, taken, height);
    taken.push(box);
    text.setAttribute("x", box.x + box.width / 2);
    text.setAttribute("y", box.y - size.y);
  }
}

// The place nearest to a box, upwards or downwards, where it covers none of the others.
function freeLine(box, others, height) {
  const lowest = height - box.height;
  const inside = Math.max(0, Math.min(lowest, box.y));
  const near = others.filter((each) => each.x < box.x + box.width && box.x < each.x + each.width);
  return [inside, ...near.flatMap((each) => [each.y - box.height, each.y + each.height])]
    .filter((y) => y >= 0 && y <= lowest)
    .filter((y) => near.every((each) => y + box.height <= each.y || each.y + each.height <= y))
    .sort((one, other) => Math.abs(one - inside) - Math.abs(other - inside))[0] ?? inside;
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
  on.picture.replaceChildren(...shapes, ...scaleBar(on, 24));
}

// How much farther down the ground is for each metre forward, in the vehicle's own axes.
function groundSlope({ rise_north: north, rise_east: east }) {
  if (!state.attitude) return -north;
  const { pitch_rad: pitch, yaw_rad: yaw } = state.attitude;
  return Math.tan(pitch) - (north * Math.cos(yaw) + east * Math.sin(yaw));
}
