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
