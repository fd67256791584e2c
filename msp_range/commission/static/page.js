// One WebSocket: what is to be shown comes in, answers go out. The secret lets the same browser come again.
const byId = (id) => document.getElementById(id);
const KEY = "msp-range commissioning";
const code = new URLSearchParams(location.search).get("code");
let socket, ended = false, endMs = 0;

function made(name, text, more = {}) {
  return Object.assign(document.createElement(name), { textContent: text }, more);
}

function open(first) {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.onopen = () => socket.send(JSON.stringify(first));
  socket.onmessage = (event) => show(JSON.parse(event.data));
  socket.onclose = () => {
    const secret = sessionStorage.getItem(KEY);
    if (secret && !ended) setTimeout(() => open({ secret }), 1000);
  };
}

function answer(number, value) {
  byId("ask").hidden = true;
  socket.send(JSON.stringify({ number, answer: value }));
}

function question({ text, number, answers }) {
  const form = byId("ask");
  form.hidden = false;
  form.dataset.number = number;
  byId("now").textContent = text;
  if (answers.length) {
    form.replaceChildren(...answers.map((each, index) => made("button", each, {
      type: "button", className: index ? "other" : "", onclick: () => answer(number, each),
    })));
    return;
  }
  const input = made("input", "", { inputMode: "decimal", ariaLabel: "height in metres" });
  form.replaceChildren(input, made("button", "Send"));
  form.onsubmit = (event) => { event.preventDefault(); answer(number, input.value); };
}

function log(text) {
  byId("log").prepend(made("p", text));
}

function show(message) {
  const { kind, text } = message;
  if (kind === "open") {
    sessionStorage.setItem(KEY, message.secret);
    endMs = Date.now() + 1000 * message.left_s;
    byId("enter").hidden = true;
    byId("log").replaceChildren();
    return;
  }
  if (kind === "refused") {
    sessionStorage.removeItem(KEY);
    byId("enter").hidden = false;
    byId("now").textContent = text;
    return;
  }
  if (kind === "question") question(message);
  else if (kind === "line") log(text);
  else byId("ask").hidden = true;
  if (kind === "instruction") {
    byId("now").textContent = text;
    navigator.vibrate?.(300);
  }
  if (kind === "instruction" || kind === "question") log(text);
  if (kind === "end") {
    ended = true;
    byId("now").textContent = text;
    sessionStorage.removeItem(KEY);
  }
}

setInterval(() => {
  const leftS = Math.max(0, Math.round((endMs - Date.now()) / 1000));
  byId("left").textContent = endMs && !ended ? `${Math.floor(leftS / 60)}:${String(leftS % 60).padStart(2, "0")} left` : "";
}, 500);

byId("enter").onsubmit = (event) => {
  event.preventDefault();
  open({ code: byId("code").value.trim() });
};
const secret = sessionStorage.getItem(KEY);
if (secret) open({ secret });
else if (code) open({ code });
history.replaceState(null, "", location.pathname);
