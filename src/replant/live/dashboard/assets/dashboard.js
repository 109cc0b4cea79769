// The page: a websocket delivers views, of which the newest is drawn; buttons send commands.
import { clock, count, percent, rate, shortly, uncertain } from "./format.js";
import { inputChoice } from "./inputs.js";
import { fillModes, typeset } from "./model.js";
import { splane } from "./plane.js";
import { dragging, readColours } from "./chart.js";
import { parameterPlots } from "./parameters.js";
import { bodePlots, stepPlot } from "./responses.js";
import { signalPlots } from "./signals.js";
import { timeSpan } from "./span.js";
import { drawVerdict } from "./verdict.js";

const at = id => document.getElementById(id);
const write = (place, text) => { if (place.textContent !== text) place.textContent = text; };
const page = { view: null, history: null, slow: {}, shown: {}, paused: false, due: false, acting: false };

// --- figures ---
const total = counts => Object.values(counts ?? {}).reduce((sum, value) => sum + value, 0);

function drawVitals(view) {
  write(at("source"), view.source || "replant live");
  at("source").title = view.source;
  write(at("clock"), clock(view.at));
  write(at("samples"), count(view.samples));
  write(at("rate"), rate(view.rate));
  write(at("lag"), shortly(view.lag));
  write(at("rejected"), count(total(view.rejected)));
  const lost = [...Object.entries(view.rejected ?? {}), ...Object.entries(view.counters ?? {})].filter(([, value]) => value);
  write(at("losses"), lost.length ? lost.map(([reason, value]) => `${count(value)} ${reason}`).join(" · ")
    : "No sample was rejected, lost or malformed so far.");
  write(at("adapt"), view.adapting ? "Freeze" : "Adapt");
  at("adapt").title = view.adapting ? "Stop updating the parameters; samples are still judged" : "Update the parameters again";
}

/** Name input and output beside their headings, where they have names. */
function nameSignals({ input_label: input, output_label: output }) {
  write(at("input-name"), input && input !== "input" ? input : "");
  write(at("output-name"), output && output !== "output" ? output : "");
}

function small(place, [value, std]) {
  const note = document.createElement("small");
  note.textContent = std;
  place.replaceChildren(value + " ", note);
}

// --- drawing: the newest view, at most once a frame, and only while the page is visible ---
const span = timeSpan(at("span"), ask);
const time = signalPlots(span), bode = bodePlots(ask), step = stepPlot(ask), parameters = parameterPlots(at("multiples"), span);
const plane = splane(at("plane")), input = inputChoice(at("inputs"), ask);
addEventListener("mouseup", ask); // what came while a stretch was being chosen
readColours();

function draw() {
  page.due = false;
  if (!page.paused) page.shown = { view: page.view && { ...page.view, ...page.slow }, history: page.history };
  const { view, history } = page.shown; // paused, another stretch of it may be chosen
  if (!view || document.hidden || dragging()) return;
  drawVitals(view);
  drawVerdict(view, apartFrom());
  const one = input.of(view);
  at("main").dataset.model = view.den?.length ? "yes" : "no";
  typeset(at("formula"), one);
  write(at("fit"), percent(view.simulated));
  nameSignals(view);
  at("main").dataset.truth = one.truth ? "yes" : "no";
  small(at("gain"), uncertain(one.dc_gain, one.dc_gain_std));
  fillModes(at("modes"), one);
  time.draw(view);
  bode.draw(one);
  step.draw(one);
  plane.draw(one);
  if (history) parameters.draw(view, history);
  at("main").dataset.drawn = String(1 + Number(at("main").dataset.drawn ?? 0));
  showLink();
}

function ask() {
  if (page.due) return;
  page.due = true;
  requestAnimationFrame(draw);
}

// --- the connection ---
const LINKS = { connected: "connected", connecting: "connecting to the source", waiting: "source lost, trying again", ended: "source has ended" };
const OVER = 1000; // the code with which the server closes the websocket when the session has ended
const FIRST = 250, LONGEST = 60_000; // ms, pauses before connecting again
const SILENT = 15_000; // ms without a view, of which five come a second, after which the session is not heard any more
let socket = null, wait = FIRST, open = false, over = false, timer = 0, heard = 0;

/** Why the page shows the past: "over", "lost" or "silent"; empty while it shows the present. */
function apartFrom() {
  if (over) return "over";
  if (!open) return "lost";
  return performance.now() - heard > SILENT ? "silent" : "";
}

function showLink() {
  const link = at("link"), view = page.view, apart = apartFrom();
  let state = open ? (view?.source_state ?? "connecting") : "reconnecting";
  let text = open ? (view ? (LINKS[state] ?? state) : "connecting") : "reconnecting";
  if (apart === "over") [state, text] = ["ended", "session has ended"];
  if (apart === "silent") [state, text] = ["waiting", "the session does not answer"];
  if (open && state === "connected" && view && !view.adapting) [state, text] = ["frozen", "connected, frozen"];
  if (page.paused) text += ", drawing paused";
  link.dataset.state = state;
  write(link.querySelector("span"), text);
  at("main").dataset.fresh = apart ? "no" : "yes";
  at("pause").hidden = at("save").hidden = over;
  at("reset").disabled = !open || !view || page.acting;
  at("adapt").disabled = at("reset").disabled || view.status === "starting"; // there is nothing to freeze yet
}

function connect() {
  clearTimeout(timer);
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.onmessage = event => {
    const message = JSON.parse(event.data);
    if (!open) { open = true; wait = FIRST; say(""); }
    heard = performance.now();
    if (message.view) page.view = message.view;
    if (message.history) page.history = message.history;
    if (message.slow) page.slow = message.slow;
    if (page.paused) showLink();
    else ask();
  };
  socket.onclose = event => {
    open = false;
    over = event.code === OVER;
    showLink();
    if (page.view) drawVerdict(page.view, apartFrom());
    if (over) say("The session has ended. Reload this page when a new session has started.");
    else if (!document.hidden) {
      timer = setTimeout(connect, wait * (0.75 + Math.random() / 2));
      wait = Math.min(2 * wait, LONGEST);
    }
  };
}

/** Connect at once after a pause: the page is visible again, or the network is back. */
function comeBack() {
  if (open || over || document.hidden || socket.readyState !== WebSocket.CLOSED) return;
  wait = FIRST;
  connect();
}

setInterval(() => {
  if (apartFrom() !== "silent" || at("main").dataset.fresh === "no") return;
  showLink();
  if (page.view) drawVerdict(page.view, apartFrom());
}, 1000);

// --- actions ---
function say(text) {
  at("notice").hidden = !text;
  write(at("notice"), text);
}

async function post(path) {
  try {
    const answer = await fetch(path, { method: "POST" });
    if (answer.ok) { say(""); return answer; }
    say((await answer.text()).trim() || `The server answered ${answer.status}.`);
  } catch {
    say("The server cannot be reached: the command was not executed.");
  }
  return null;
}

at("pause").addEventListener("click", () => {
  page.paused = !page.paused;
  write(at("pause"), page.paused ? "Resume" : "Pause");
  at("pause").classList.toggle("on", page.paused);
  showLink();
  ask();
});

async function act(name) {
  page.acting = true;
  showLink();
  await post(`/command/${name}`);
  page.acting = false;
  showLink();
}
at("adapt").addEventListener("click", () => act(page.view?.adapting ? "freeze" : "adapt"));

const sure = at("sure");
at("reset").addEventListener("click", () => { sure.returnValue = "no"; sure.showModal(); });
sure.addEventListener("close", () => { if (sure.returnValue === "yes") act("reset"); });

const menu = at("save");
document.addEventListener("click", event => { if (!menu.contains(event.target)) menu.open = false; });
menu.addEventListener("keydown", event => {
  if (event.key !== "Escape" || !menu.open) return;
  menu.open = false;
  menu.querySelector("summary").focus();
});
menu.querySelectorAll("a").forEach(link => link.addEventListener("click", () => { menu.open = false; }));

at("report").addEventListener("click", async () => {
  at("report").disabled = true;
  menu.open = false;
  menu.querySelector("summary").focus();
  say("The report is being made…");
  const answer = await post("/report");
  if (answer) {
    const link = document.createElement("a"), url = URL.createObjectURL(await answer.blob());
    Object.assign(link, { href: url, download: "report.html" }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
  }
  at("report").disabled = false;
});

// --- start ---
if (new URLSearchParams(location.search).has("token")) history.replaceState(null, "", location.pathname); // it is in a cookie now
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  readColours();
  for (const chart of [...time.charts, ...bode.charts, ...step.charts, ...parameters.charts]) chart.repaint();
});
document.addEventListener("visibilitychange", () => { ask(); comeBack(); });
addEventListener("online", comeBack);
connect();
