// The page: views, logs that are opened or dropped, and what is drawn when the session changes.
import { readColours } from "/assets/chart.js";
import { foldable, forgetToken, whenDark } from "/assets/served.js";
readColours();
const { act, at, connect, element, fill, keep, kept, log, say, send, state, whenever, write } = await import("./page.js");
const { drawData, repaintData } = await import("./data.js");
const { drawCards, drawWish, whenLooked } = await import("./models.js");
const { drawCompare, lookAt, repaintCompare } = await import("./compare.js");
const { drawKeep } = await import("./keep.js");

// --- views ---
const wide = matchMedia("(min-width: 72rem)");
function view(name) {
  const shown = name === "models" && wide.matches ? "data" : name;
  document.body.dataset.view = shown;
  for (const button of document.querySelectorAll("nav [data-view]")) {
    if (button.dataset.view === shown) button.setAttribute("aria-current", "page");
    else button.removeAttribute("aria-current");
  }
  keep({ view: shown === "data" ? null : shown });
  draw();
}
for (const button of document.querySelectorAll("nav [data-view]")) button.addEventListener("click", () => view(button.dataset.view));
wide.addEventListener("change", () => view(document.body.dataset.view));
whenLooked((...what) => { view("compare"); lookAt(...what); });

// --- drawing ---
function drawLogs({ logs, active }) {
  document.body.dataset.logs = logs.length ? "some" : "none";
  at("empty").hidden = logs.length > 0;
  at("logs-label").hidden = !logs.length;
  const told = JSON.stringify(logs.map(each => [each.name, each.file]));
  if (at("logs").dataset.told !== told) {
    at("logs").dataset.told = told;
    at("logs").replaceChildren(...logs.map(each => element("option", { value: each.name, title: each.path }, each.file)));
  }
  fill(at("logs"), active);
  const opened = log();
  document.title = opened ? `${opened.file} – replant workbench` : "replant workbench";
  at("grown").hidden = !opened?.grown || opened.state !== "ready";
  write(at("grown").querySelector("span"), opened ? `${opened.file} has changed since it was read.` : "");
}

function draw() {
  if (!state.session) return;
  drawLogs(state.session);
  drawData();
  drawWish();
  drawCards();
  drawCompare();
  drawKeep();
}
whenever(draw);
addEventListener("hashchange", draw);
document.addEventListener("click", () => queueMicrotask(drawKeep));

// --- logs ---
async function upload(files) {
  for (const file of files) {
    say(`${file.name} is being read…`);
    const answer = await send(`/logs?name=${encodeURIComponent(file.name)}`, file);
    if (!answer) return;
  }
  say("");
}
for (const name of ["open", "open-first", "open-session"]) at(name).addEventListener("click", () => at("file").click());
at("file").addEventListener("change", async () => { await upload([...at("file").files]); at("file").value = ""; });
at("logs").addEventListener("change", () => act("activate", { log: at("logs").value }));
at("close-log").addEventListener("click", () => log() && act("close", { log: log().name }));
at("read-again").addEventListener("click", () => act("read-again", { log: log().name }));

let depth = 0;
const carries = event => event.dataTransfer?.types.includes("Files");
addEventListener("dragenter", event => { if (carries(event)) { depth += 1; at("dropping").hidden = false; } });
addEventListener("dragleave", event => { if (carries(event) && (depth -= 1) <= 0) { depth = 0; at("dropping").hidden = true; } });
addEventListener("dragover", event => { if (carries(event)) event.preventDefault(); });
addEventListener("drop", event => {
  if (!carries(event)) return;
  event.preventDefault();
  depth = 0;
  at("dropping").hidden = true;
  upload([...event.dataTransfer.files]);
});

// --- menu ---
foldable(at("session"));

// --- start ---
forgetToken();
whenDark(() => { repaintData(); repaintCompare(); });
view(kept().get("view") ?? "data");
connect();
