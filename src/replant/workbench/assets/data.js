// The view of the data: columns with their roles, all signals over time, what the inspection found, and conditioning.
import { act, ask, at, check, choose, element, fill, keep, kept, keyed, later, log, say, write } from "./page.js";
import { addStretch, drawStretches, nice, shaded, typed } from "./marks.js";
import { merged, strokes, timeAxis } from "./curves.js";
import { chart, extent, labelled, line, seen, steady, unlabelled, zoomed, zoomKeys } from "/assets/chart.js";
import { count, number } from "/assets/format.js";

const LOOKS = { output: ["measured", "tall"], input: ["input", "short"], reference: ["line-3", "short"] };
const ORDER = ["output", "input", "reference"];
const ROLE_NAMES = [["", "unused"], ["time", "time"], ["input", "input"], ["output", "output"], ["reference", "reference"]];
const plots = new Map();
let shown = null, signals = null, changed = null, mode = "zoom", asked = "", drawnFor = "";

// --- columns ---
function drawColumns({ columns, name }) {
  keyed(at("columns"), columns.filter(each => each.in_record || each.problem).slice(0, 200), each => `${name} ${each.number}`, each => {
    const select = element("select", { "aria-label": `Role of column ${each.name}` }, ...ROLE_NAMES.map(([value, text]) => element("option", { value }, text)));
    select.addEventListener("change", () => act("role", { log: log().name, column: each.key, role: select.value }));
    if (each.problem) select.disabled = true;
    return element("li", {}, element("span", { class: "name", title: each.name }, each.name || "(no name)"), select, element("small", {}));
  }, (row, each) => {
    const select = row.querySelector("select");
    fill(select, each.role);
    row.dataset.role = each.role;
    const about = each.problem ? "no numbers" : `${number(each.min, 4)} … ${number(each.max, 4)}`;
    const more = [each.missing && !each.problem ? `${count(each.missing)} missing` : "", each.quantised ? `steps of ${number(each.step, 3)}` : ""].filter(Boolean);
    write(row.querySelector("small"), [about, ...more].join(", "));
  });
}

function drawFindings({ findings }) {
  const rows = findings.flatMap(([heading, text]) => (heading ? [element("dt", {}, heading), element("dd", {}, text)] : [element("dd", {}, text)]));
  const told = JSON.stringify(findings);
  if (at("findings").dataset.told === told) return;
  at("findings").dataset.told = told;
  at("findings").replaceChildren(...rows);
}

/** What may be wrong, with a button that shows it and one that leaves it out. */
function drawDoubts({ doubts, setup }) {
  keyed(at("doubts"), doubts, each => `${each.begin} ${each.end} ${each.what}`, each => {
    const width = each.end - each.begin, words = `${number(each.begin, 4)} – ${number(each.end, 4)} s: ${each.what}`;
    return element("li", {}, element("button", { type: "button", class: "reason", title: "Show it", onclick: () => show([each.begin - 2 * width, each.end + 2 * width]) }, words),
      element("button", { type: "button", class: "small", onclick: () => addStretch("leave_out", +each.begin.toPrecision(12), +each.end.toPrecision(12)) }, "Leave out"));
  }, (row, each) => {
    row.lastChild.disabled = setup.leave_out.some(([from, to]) => from <= each.begin + 1e-9 && (to ?? Infinity) >= each.end - 1e-9);
  });
}

// --- signals ---
/** Which columns are drawn, those with a role first; time is the axis. */
function drawn({ columns }) {
  const roles = each => (ORDER.indexOf(each.role) + 1 || 9);
  return columns.filter(each => each.drawn && each.role !== "time").sort((a, b) => roles(a) - roles(b) || a.number - b.number);
}

function makePlot(column) {
  const place = element("div", { class: "plot", tabindex: "0", role: "group" });
  const figure = element("figure", {}, element("figcaption", {}, element("h2", {}), element("span", { class: "role aside" }), element("span", { class: "legend" },
    element("b", {}), element("span", { class: "after" }, element("i", {}), "as identified"))), place);
  figure.querySelector(".after i").style.borderColor = "var(--model)";
  const plot = { figure, place, fit: steady(), limits: [0, 1], role: null, column };
  zoomKeys(place, zoomBy);
  return plot;
}

/** The chart of a column, made anew where its role, and so its size and colour, has changed. */
function chartOf(plot, role, last) {
  if (plot.role === role && plot.last === last && plot.chart) return plot.chart;
  plot.chart?.plot.destroy();
  [plot.role, plot.last] = [role, last];
  const [tint, size] = LOOKS[role] ?? ["muted", "short"];
  plot.place.className = `plot ${size}`;
  plot.chart = chart(plot.place, {
    series: [line(tint, { width: role === "output" ? 1.75 : 1.25 }), line("model", { width: 1.25 })], x: last ? timeAxis(() => all()[1]) : unlabelled, y: labelled, cursor: "data",
    choose: chosen, limits: () => [range(), plot.limits], leftOut: () => (log() ? shaded(log().setup, all()[1]) : []),
    read: i => write(plot.figure.querySelector("b"), i === null ? "" : number(plot.data?.[1]?.[i], 5)),
  });
  return plot.chart;
}

const all = () => signals?.all ?? [0, 1];
const range = () => shown ?? all();

/** What a stretch that was dragged is for; none after a double click. */
function chosen(stretch) {
  if (!stretch || mode === "zoom") { show(stretch); return; }
  const width = range()[1] - range()[0], [from, to] = stretch.map(value => nice(value, width));
  addStretch(mode, from, to >= all()[1] ? null : to);
}

function show(stretch) {
  shown = stretch && [Math.max(stretch[0], all()[0]), Math.min(stretch[1], all()[1])];
  if (shown && !(shown[1] > shown[0])) shown = null;
  keep({ from: shown?.[0].toPrecision(12) ?? null, to: shown?.[1].toPrecision(12) ?? null });
  paint();
  refine();
}

const zoomBy = how => show(zoomed(range(), how, all()));

function data(column) {
  const [low, high] = signals.columns[column.number] ?? [[], null];
  const [x, y] = strokes(signals.t ?? [], low, high), role = ["input", "output"].includes(column.role) ? column.role : null;
  const after = role && changed?.signals[role];
  if (!after) return [x, y, x.map(() => null)];
  const [ax, ay] = strokes(after.t, after.low, after.high);
  return merged(x, y, ax, ay);
}

function paint() {
  const opened = log();
  if (!opened || !signals) return;
  const columns = drawn(opened).filter(each => signals.columns[each.number]), known = new Set();
  let place = at("plots").firstChild;
  columns.forEach((column, i) => {
    const key = `${opened.name} ${column.number}`;
    known.add(key);
    if (!plots.has(key)) plots.set(key, makePlot(column));
    const plot = plots.get(key);
    if (plot.figure !== place) at("plots").insertBefore(plot.figure, place);
    else place = place.nextSibling;
    write(plot.figure.querySelector("h2"), column.name || "(no name)");
    write(plot.figure.querySelector(".role"), column.role || "unused");
    plot.place.setAttribute("aria-label", `${column.name} over time. Arrow keys pan, plus and minus zoom, Escape shows everything.`);
    const made = chartOf(plot, column.role, i === columns.length - 1);
    plot.data = data(column);
    plot.figure.querySelector(".after").hidden = !(changed && ["input", "output"].includes(column.role));
    plot.limits = plot.fit(...extent(seen(plot.data[0], range(), plot.data[1])));
    made.draw(plot.data);
  });
  for (const [key, plot] of plots) {
    if (known.has(key)) continue;
    plot.chart?.plot.destroy();
    plot.figure.remove();
    plots.delete(key);
  }
  const [from, to] = range(), digits = Math.min(12, 3 + Math.ceil(Math.log10(Math.max(to / (to - from), 1))));
  write(at("shown"), `${+from.toPrecision(digits)} … ${+to.toPrecision(digits)} s`);
  document.body.dataset.drawn = String(1 + Number(document.body.dataset.drawn ?? 0));
}

/** Ask for the signals of what is shown, and the same as they are identified. */
async function fetchSignals() {
  const opened = log();
  if (!opened || !opened.rows) return;
  const points = Math.max(300, Math.round(at("plots").clientWidth || 600)), between = shown ? { from: shown[0], to: shown[1] } : {};
  const found = await ask("signals", { log: opened.name, points, ...between });
  if (!found || log()?.name !== opened.name) return;
  signals = found;
  paint();
  const { detrend, decimate, resample } = opened.setup, conditions = detrend || decimate !== null || resample !== null;
  changed = conditions ? await ask("conditioned", { log: opened.name, points, ...between }) : null;
  write(at("conditioned"), changed ? `${count(changed.samples)} samples, ${number(changed.dt, 4)} s apart, are identified` : "");
  if (log()?.name === opened.name) paint();
}
const refine = later(60, fetchSignals);

export function drawData() {
  const opened = log();
  if (!opened) return;
  const now = JSON.stringify([opened.name, opened.rows, opened.columns.map(each => [each.role, each.drawn]), opened.setup.dt, opened.setup.time, opened.setup.detrend,
    opened.setup.decimate, opened.setup.resample, opened.version, opened.setup.input, opened.setup.output]);
  if (drawnFor !== opened.name) {
    if (drawnFor) { shown = null; keep({ from: null, to: null }); }
    signals = changed = null;
    drawnFor = opened.name;
    if (kept().has("from")) shown = [Number(kept().get("from")), Number(kept().get("to"))];
  }
  const percent = opened.read === null ? "" : ` ${Math.round(100 * opened.read)} %`;
  write(at("reading"), { inspecting: "inspecting the log…", reading: `reading the log…${percent}`, broken: opened.error, ready: `${count(opened.rows)} row${opened.rows === 1 ? "" : "s"}` }[opened.state]);
  at("reading").classList.toggle("grave", opened.state === "broken");
  drawColumns(opened);
  drawFindings(opened);
  drawDoubts(opened);
  drawStretches(opened.setup);
  at("clock").hidden = opened.setup.dt === null;
  fill(at("dt"), opened.setup.dt === null ? "" : String(opened.setup.dt));
  check(at("detrend"), opened.setup.detrend);
  fill(at("decimate"), opened.setup.decimate === null ? "" : String(opened.setup.decimate));
  fill(at("resample"), opened.setup.resample === null ? "" : String(opened.setup.resample));
  if (now !== asked) { asked = now; refine(); }
  else paint();
}

export function repaintData() {
  for (const plot of plots.values()) plot.chart?.repaint();
}

// --- what is changed here ---
const numeric = (field, name) => at(field).addEventListener("change", () => {
  const text = at(field).value.trim(), value = text === "" ? null : typed(text);
  if (Number.isNaN(value)) say(`${name}: write a number, as in 0.01.`);
  else choose({ [field]: field === "decimate" && value === 1 ? null : value });
});
numeric("dt", "Sampling time");
numeric("decimate", "One sample of");
numeric("resample", "Samples apart");
at("detrend").addEventListener("change", () => choose({ detrend: at("detrend").checked }));

for (const button of document.querySelectorAll("[data-mode]")) {
  button.addEventListener("click", () => {
    mode = button.dataset.mode;
    for (const other of document.querySelectorAll("[data-mode]")) other.setAttribute("aria-pressed", String(other === button));
    if (mode !== "zoom") at("add-kind").value = mode;
  });
}
for (const button of document.querySelectorAll(".signals [data-zoom]")) button.addEventListener("click", () => zoomBy(button.dataset.zoom));
new ResizeObserver(refine).observe(at("plots"));
