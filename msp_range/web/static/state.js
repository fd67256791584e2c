// What the page knows of the bridge: its newest packets, and the readings of the last seconds.

export const SHOWN_S = 30;  // readings are kept and shown for so long [s]
export const OLD_S = 2;     // a range or a distance that is older is not shown as the present one [s]
const TEXTS = 30;           // reports to the pilot that are listed

export const state = {
  airframe: null, status: null, attitude: null, fused: null, autopilot: {}, texts: [],
  readings: {}, lines: [], nowS: 0, echoS: 0,
  gone: null,     // while no bridge runs: why, in the form of the status's faults
  offline: true,  // while this page's server is not reached
};

export function take({ topic, time_s: timeS, message }) {
  if (topic === "/gone") { state.gone = message.faults; return; }
  state.gone = null;
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
  }
}

export function forgetOld() {
  const first = state.nowS - SHOWN_S;
  for (const list of [...Object.values(state.readings), state.lines]) {
    const keep = list.findIndex((each) => each.timeS >= first);
    list.splice(0, keep < 0 ? list.length : keep);
  }
}

// What became of a reading: used, rejected, or nothing was measured.
export function kindOf(reading) {
  if (reading.status !== "ok") return "nothing";
  return reading.rejected ? "rejected" : "used";
}

const words = (code) => code.replaceAll("_", " ");

export function reasonOf(reading) {
  return reading.status !== "ok" ? words(reading.status) : reading.rejected ? words(reading.rejected) : "";
}

export const isLive = () => !state.gone && !state.offline;

const present = (last) => last && isLive() && state.nowS - last.timeS < OLD_S ? last : null;

export const newest = (name) => present(state.readings[name]?.at(-1));

export const presentDistance = () => present(state.fused);

export function faultOf(name) {
  return state.status?.sensors[name]?.fault ?? null;
}
