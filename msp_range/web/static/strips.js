// One strip a sensor: its readings of the last seconds, with the reason of each that was not used.

import { byId, made, metres } from "./elements.js";
import { OLD_S, SHOWN_S, faultOf, kindOf, newest, presentDistance, reasonOf, state } from "./state.js";

let shown = null;  // the airframe whose strips are there

function makeStrips() {
  shown = state.airframe;
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

export function drawStrips() {
  if (shown !== state.airframe) makeStrips();
  const style = getComputedStyle(document.documentElement);
  const colour = Object.fromEntries(["used", "filtered", "rejected", "nothing", "line", "card"].map(
    (each) => [each, style.getPropertyValue(`--${each}`)]));
  const highest = Math.ceil(Math.max(0.9, ...Object.values(state.readings).flat().map((each) => each.corrected_m ?? 0),
    ...state.lines.map((each) => each.rangeM)) + 0.1);
  byId("highest").textContent = highest;
  for (const row of byId("strips").children) {
    const name = row.dataset.strip;
    const canvas = row.querySelector("canvas");
    const on = plot(canvas, highest, colour);
    if (row.dataset.fused) {
      on.line(state.lines.map(({ timeS, rangeM }) => [timeS, rangeM]), colour.used);
      row.querySelector(".more").textContent = presentDistance() ? metres(state.fused.range_m) : "none";
      continue;
    }
    const readings = state.readings[name] ?? [];
    on.line(readings.filter((each) => each.filtered_m !== undefined).map((each) => [each.timeS, each.filtered_m]), colour.filtered);
    for (const each of readings) on.mark(each, colour);
    const last = newest(name);
    const fault = faultOf(name);
    row.classList.toggle("faulty", fault !== null || !last);
    const range = last?.corrected_m;
    row.querySelector(".more").replaceChildren(range === undefined || fault ? "" : metres(range) + " ",
      made("small", fault ?? (last ? reasonOf(last) : "no reading")));
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
  pen.font = "14px system-ui, sans-serif";
  const x = (timeS) => (1 - (state.nowS - timeS) / SHOWN_S) * (width - 4);
  const y = (rangeM) => 3 + (1 - rangeM / highest) * (height - 8);
  pen.strokeStyle = colour.line;
  pen.beginPath();
  for (const agoS of [0, 10, 20, 30]) {
    pen.moveTo(x(state.nowS - agoS), 0);
    pen.lineTo(x(state.nowS - agoS), height);
  }
  pen.stroke();
  let lastReason = "";
  let lastEnd = -1e9;
  return {
    line(points, stroke) {
      pen.strokeStyle = stroke;
      pen.lineWidth = 2;
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
      if (kind === "nothing") pen.fillRect(px - 1.5, height - 6, 3, 6);
      else if (kind === "used") { pen.beginPath(); pen.arc(px, py, 2.5, 0, 7); pen.fill(); }
      else pen.strokeRect(px - 3, py - 3, 6, 6);
      const reason = reasonOf(reading);
      const size = reason ? pen.measureText(reason).width : 0;
      const textX = Math.min(px + 5, width - size);
      if (reason && textX > lastEnd + (reason === lastReason ? 40 : 4)) {
        const textY = kind === "nothing" ? height - 9 : Math.max(py - 5, 12);
        [pen.strokeStyle, pen.lineWidth] = [colours.card, 3];
        pen.strokeText(reason, textX, textY);
        pen.fillText(reason, textX, textY);
        [lastReason, lastEnd] = [reason, textX + size];
      }
    },
  };
}
