// The page: a websocket delivers views, of which the newest is drawn; buttons send commands.
import { clock, count, percent, rate, shortly, uncertain } from "./format.js";
import { inputChoice } from "./inputs.js";
import { fillModes, typeset } from "./model.js";
import { splane } from "./plane.js";
import { dragging, readColours } from "./chart.js";
import { answered, at, connection, download, element, foldable, forgetToken, say, whenDark, write } from "./served.js";
import { parameterPlots } from "./parameters.js";
import { bodePlots, stepPlot } from "./responses.js";
import { signalPlots } from "./signals.js";
import { timeSpan } from "./span.js";
import { drawVerdict } from "./verdict.js";

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
  const [gain, std] = uncertain(one.dc_gain, one.dc_gain_std);
  at("gain").replaceChildren(gain + " ", element("small", {}, std));
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
const LONGEST = 60_000; // ms, pause before connecting again
const SILENT = 15_000; // ms without a view, of which five come a second, after which the session is not heard any more
let open = false, over = false, heard = 0;

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

function told(message) {
  if (!open) { open = true; say(""); }
  heard = performance.now();
  if (message.view) page.view = message.view;
  if (message.history) page.history = message.history;
  if (message.slow) page.slow = message.slow;
  if (page.paused) showLink();
  else ask();
}

function closed(code) {
  open = false;
  over = code === OVER;
  showLink();
  if (page.view) drawVerdict(page.view, apartFrom());
  if (over) say("The session has ended. Reload this page when a new session has started.");
  return !over && !document.hidden;
}

/** Connect at once after a pause: the page is visible again, or the network is back. */
function comeBack() {
  if (!open && !over && !document.hidden) server.again();
}

setInterval(() => {
  if (apartFrom() !== "silent" || at("main").dataset.fresh === "no") return;
  showLink();
  if (page.view) drawVerdict(page.view, apartFrom());
}, 1000);

// --- actions ---
async function post(path) {
  const answer = await answered(path, { method: "POST" }, "The server cannot be reached: the command was not executed.");
  if (answer) say("");
  return answer;
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
foldable(menu);

at("report").addEventListener("click", async () => {
  at("report").disabled = true;
  menu.open = false;
  menu.querySelector("summary").focus();
  say("The report is being made…");
  const answer = await post("/report");
  if (answer) download(await answer.blob(), "report.html");
  at("report").disabled = false;
});

// --- start ---
forgetToken();
whenDark(() => { for (const chart of [...time.charts, ...bode.charts, ...step.charts, ...parameters.charts]) chart.repaint(); });
document.addEventListener("visibilitychange", () => { ask(); comeBack(); });
addEventListener("online", comeBack);
const server = connection(LONGEST, told, closed);
