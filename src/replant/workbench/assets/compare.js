// The comparison: the chosen models over the measured output, their responses, and what they leave.
import { ask, at, element, keep, kept, keyed, later, log, state, write } from "./page.js";
import { curveLimits, manyCurves, ROLES, strokes, timeAxis } from "./curves.js";
import { chosen, reasonOf } from "./models.js";
import { extent, labelled, line, ticksOf, unlabelled, zoomed, zoomKeys } from "/assets/chart.js";
import { number, percent, tick } from "/assets/format.js";
import { splane } from "/assets/plane.js";
import { decades, DEGREES, logTicks } from "/assets/responses.js";

let found = null, shapes = null, shown = null, looked = null, asked = "", askedShapes = "";

const all = () => found?.all ?? [0, 1];
const range = () => shown ?? all();
/** What a reason speaks of, shaded in the plots over time. */
const spans = () => (looked?.stretch ? [[...looked.stretch, "warn"]] : []);

function show(stretch) {
  shown = stretch && [Math.max(stretch[0], all()[0]), Math.min(stretch[1], all()[1])];
  if (shown && !(shown[1] > shown[0])) shown = null;
  paintTime();
  refine();
}
const zoomBy = how => show(zoomed(range(), how, all()));

const measured = line("measured", { width: 2.5 });
const over = { range, choose: show, cursor: "compare", leftOut: spans };
const value = (column, i) => (i === null ? "" : number(column?.[i], 4));
const names = () => state.session.shown.map(name => state.session.cards.find(card => card.name === name));
const saying = (place, title) => (i, columns) => write(at(place), i === null ? title : at_(columns, i));
const at_ = (columns, i) => names().map((card, k) => (card && columns[1 + 3 * k]?.[i] != null ? `${card.title}: ${value(columns[1 + 3 * k], i)}` : "")).filter(Boolean).join(" · ");
const plots = {
  output: manyCurves(at("c-output"), { ...over, first: [measured], x: unlabelled, limit: (curves, inside, before) => {
    const [low, high] = extent(inside(before[0])), [least, most] = extent(...curves.map(each => inside(each.y))), room = 0.5 * (high - low || 1);
    return low === null ? [least, most] : [Math.max(Math.min(low, least ?? low), low - room), Math.min(Math.max(high, most ?? high), high + room)];
  } }),
  residual: manyCurves(at("c-residual"), { ...over, x: timeAxis(() => all()[1]), limit: (curves, inside) => extent(...curves.map(each => inside(each.y))) }),
  step: manyCurves(at("c-step"), { x: { values: (_, ticks) => ticks.map(t => `${tick(t)} s`) }, limit: curveLimits, read: saying("said-step", "± 2σ") }),
  size: manyCurves(at("c-size"), { log: true, cursor: "omega", x: { splits: logTicks, filter: (_, ticks) => ticks, values: decades }, limit: curveLimits, read: saying("said-size", "dB over rad/s, ± 2σ"), leftOut: () => frequencies() }),
  phase: manyCurves(at("c-phase"), { log: true, cursor: "omega", x: { splits: logTicks, filter: (_, ticks) => ticks, values: decades }, y: { ...labelled, incrs: DEGREES }, limit: curveLimits, read: saying("said-phase", "degrees over rad/s, ± 2σ"), leftOut: () => frequencies() }),
  auto: manyCurves(at("c-auto"), { dashed: true, x: { values: ticksOf(tick) }, limit: correlationLimits }),
  cross: manyCurves(at("c-cross"), { dashed: true, x: { values: ticksOf(tick) }, limit: correlationLimits }),
  error: manyCurves(at("c-error"), { dashed: true, log: true, cursor: "omega", x: { splits: logTicks, filter: (_, ticks) => ticks, values: decades }, y: { values: (_, ticks) => ticks.map(each => `${tick(100 * each)} %`) }, leftOut: () => frequencies(),
    limit: (curves, inside) => [0, Math.min(2, Math.max(...curves.map(each => extent(inside(each.y))[1] ?? 0), ...curves.map(each => extent(inside(each.high))[1] ?? 0), 0.01))] }),
};
const plane = splane(at("c-poles"));
for (const name of ["c-output", "c-residual"]) zoomKeys(at(name), zoomBy);

function correlationLimits(curves) {
  const [low, high] = extent(...curves.flatMap(each => [each.y, each.high, each.low]));
  return [Math.min(low ?? -1, 0), high ?? 1];
}

/** The frequencies that a reason speaks of: about a pole, or where the error exceeds its limit. */
function frequencies() {
  if (!looked || !["bode", "poles", "cross"].includes(looked.plot)) return [];
  if (looked.at) return [[looked.at / 1.2, looked.at * 1.2, "warn"]];
  const error = found?.models[looked.card]?.error;
  if (!error) return [];
  const beyond = error.omega.filter((_, i) => error.error[i] > error.limit[i]);
  return beyond.length ? [[beyond[0] / 1.02, beyond.at(-1) * 1.02, "warn"]] : [];
}

/** What each of the chosen models says, in the order of their colours. */
const each = of => names().map(card => (card && of(card.name)) || null);

function paintTime() {
  if (!found) return;
  const [x, y] = strokes(found.measured.t, found.measured.low, found.measured.high);
  const curve = kind => each(name => found.models[name]?.[kind] && { y: strokes(found.measured.t, found.models[name][kind].low, found.models[name][kind].high)[1] });
  plots.output.draw(x, curve("output"), [y]);
  plots.residual.draw(x, curve("residual"));
  write(at("said-output"), found.label);
  write(at("said-residual"), "measured − model");
}

function paintRest() {
  if (!found) return;
  const lags = kind => each(name => {
    const c = found.models[name]?.correlations;
    if (!c) return null;
    const y = kind === "auto" ? c.auto.slice(1) : c.cross, limit = c[`limit_${kind}`];
    return { y, high: y.map(() => limit), low: y.map(() => -limit) };
  });
  for (const kind of ["auto", "cross"]) {
    const curves = lags(kind), long = Math.max(0, ...curves.filter(Boolean).map(curve => curve.y.length)), first = kind === "auto" ? 1 : -(long - 1) / 2;
    const padded = curves.map(curve => curve && (kind === "cross" ? centred(curve, long) : curve));
    plots[kind].draw(Array.from({ length: long }, (_, i) => first + i), padded);
  }
  const errors = each(name => found.models[name]?.error), omega = [...new Set(errors.filter(Boolean).flatMap(error => error.omega))].sort((a, b) => a - b);
  plots.error.draw(omega, errors.map(error => {
    if (!error) return null;
    const by = new Map(error.omega.map((w, i) => [w, i])), of = column => omega.map(w => (by.has(w) ? column[by.get(w)] : undefined));
    return { y: of(error.error), high: of(error.limit) };
  }));
}

/** A correlation with fewer lags than another one's, about the same lag 0. */
function centred(curve, long) {
  const more = new Array((long - curve.y.length) / 2).fill(null), wide = column => [...more, ...column, ...more];
  return { y: wide(curve.y), high: wide(curve.high), low: wide(curve.low) };
}

function paintShapes() {
  if (!shapes) return;
  const of = (kind, name, spread) => each(model => {
    const found = shapes.models[model]?.[kind];
    return found && { y: found[name], high: found[name].map((y, i) => sum(y, found[spread][i])), low: found[name].map((y, i) => sum(y, found[spread][i] === null ? null : -found[spread][i])) };
  });
  const first = Object.values(shapes.models)[0];
  plots.step.draw(first?.step.t ?? [], of("step", "y", "wide"));
  plots.size.draw(shapes.omega ?? [], of("bode", "size", "wide"));
  plots.phase.draw(shapes.omega ?? [], of("bode", "phase", "turn"));
  const poles = names().flatMap((card, i) => (card && shapes.models[card.name]?.poles.map(pole => ({ ...pole, role: ROLES[i] }))) || []);
  const zeros = names().flatMap((card, i) => (card && shapes.models[card.name]?.zeros.map(zero => ({ ...zero, role: ROLES[i] }))) || []);
  plane.draw({ poles, zeros, pole_covariance: poles.map(regionOf) });
}
const sum = (a, b) => (a === null || b === null ? null : a + b);
/** The region of a pole; none where it is less well known than its size, as it would hide all others. */
const regionOf = ({ real, imag, covariance: c }) => (c && c[0][0] !== null && c[0][0] + c[1][1] < real ** 2 + imag ** 2 ? c : null);

function paintVerdicts() {
  const items = names().filter(Boolean).map(card => ({ card, here: found?.models[card.name] }));
  keyed(at("verdicts"), items, item => item.card.name, () => element("details", {}, element("summary", {}, element("i", { class: "tint", "aria-hidden": "true" }), element("span", { class: "who" }), element("b", {}), element("span", { class: "word" }), element("span", { class: "first aside" })), element("ul", { class: "reasons" })), (row, { card, here }) => {
    row.querySelector(".tint").style.background = `var(--${ROLES[state.session.shown.indexOf(card.name)]})`;
    write(row.querySelector(".who"), card.title);
    write(row.querySelector("b"), here?.fit !== undefined ? percent(here.fit) : "");
    const word = row.querySelector(".word"), verdict = here?.verdict;
    word.dataset.gravity = verdict?.gravity ?? "none";
    write(word, verdict?.headline ?? "");
    write(row.querySelector(".first"), here?.failed ?? verdict?.reasons[0]?.text ?? (here ? "" : "computing output, residual and verdict…"));
    const told = JSON.stringify(verdict ?? null);
    if (row.dataset.told !== told) {
      row.dataset.told = told;
      row.querySelector("ul").replaceChildren(...(verdict?.reasons ?? []).map(reason => reasonOf(reason, card, "here")));
    }
  });
}

async function fetchTime() {
  const opened = log();
  if (!opened?.rows || !names().some(Boolean) || document.body.dataset.view !== "compare") return;
  const points = Math.max(300, Math.round(at("c-output").clientWidth || 600));
  const answer = await ask("compared", { log: opened.name, part: at("part").value, points, ...(shown ? { from: shown[0], to: shown[1] } : {}) });
  if (!answer || log()?.name !== opened.name) return;
  found = { ...answer, label: `${opened.columns.find(each => each.role === "output")?.name ?? ""}, measured and modelled` };
  paintTime();
  paintRest();
  paintVerdicts();
  document.body.dataset.compared = String(1 + Number(document.body.dataset.compared ?? 0));
}
const refine = later(60, fetchTime);

async function fetchShapes() {
  shapes = (await ask("responses", {})) ?? shapes;
  paintShapes();
}

function drawParts({ setup, name }) {
  const parts = setup.validate_on.map(([from, to], i) => [String(i), `validation, ${+from.toPrecision(6)} s – ${to === null ? "end" : `${+to.toPrecision(6)} s`}`]);
  const options = [...parts, ["", "all of the log"]], told = JSON.stringify([name, options]), select = at("part");
  if (select.dataset.told === told) return;
  const before = select.dataset.told ? select.value : (kept().get("part") ?? "0");
  select.dataset.told = told;
  select.replaceChildren(...options.map(([value, text]) => element("option", { value }, text)));
  select.value = options.some(([value]) => value === before) && !(before === "" && parts.length && !kept().has("part")) ? before : options[0][0];
}

export function drawCompare() {
  const opened = log();
  if (!opened || !state.session) return;
  drawParts(opened);
  const some = names().some(Boolean), models = names().map(card => card && [card.name, card.title, card.state, card.samples]);
  write(at("nothing"), some ? "" : "Tick models to compare them.");
  at("nothing").hidden = some;
  keyed(at("compared"), [{ key: "measured", role: "measured", text: "measured" }], item => item.key, item => element("span", {}, element("i", { class: "thick" }), item.text), (row, item) => { row.firstChild.style.borderColor = `var(--${item.role})`; });
  document.querySelector(".compare").dataset.some = String(some);
  if (document.body.dataset.view !== "compare") return;
  const { input, output, reference, time, dt, detrend, decimate, resample, validate_on } = opened.setup;
  const now = JSON.stringify([opened.name, opened.version, models, at("part").value, input, output, reference, time, dt, detrend, decimate, resample, validate_on]), ofShapes = JSON.stringify(models);
  if (now !== asked) { if (asked) shown = looked ? shown : null; asked = now; refine(); }
  if (ofShapes !== askedShapes) { askedShapes = ofShapes; fetchShapes(); }
  paintVerdicts();
}

/** Show in the plots what a reason speaks of; part: on which part of the log, or null for what the model was made from. */
export function lookAt(reason, card, part) {
  if (part === null) at("part").value = "";
  else if (part !== "here") at("part").value = String(part);
  keep({ part: at("part").value || null });
  const setup = log().setup, stretch = part === null ? null : setup.validate_on[Number(at("part").value)] ?? null;
  const last = stretch ? (stretch[1] ?? found?.all[1] ?? Infinity) : usedUntil(setup, found?.all[1] ?? Infinity);
  looked = { ...reason, card: card.name, stretch: reason.since && Number.isFinite(last) ? [Math.max(0, last - reason.since), last] : null };
  for (const figure of document.querySelectorAll(".looked")) figure.classList.remove("looked");
  const place = at({ output: "c-output", residual: "c-residual", cross: "c-cross", auto: "c-auto", bode: "c-size", poles: "c-poles" }[reason.plot]);
  place.closest("figure").classList.add("looked");
  requestAnimationFrame(() => {
    drawCompare();
    paintTime();
    paintShapes();
    paintRest();
    place.closest("figure").scrollIntoView({ block: "center" });
  });
}

/** Until when the outputs are used: to the end, unless a stretch at the end is left out. */
function usedUntil(setup, end) {
  const used = setup.use.length ? Math.max(...setup.use.map(([, to]) => to ?? end)) : end;
  return [...setup.leave_out, ...setup.validate_on].reduce((until, [from, to]) => ((to ?? end) >= until ? Math.min(until, from) : until), used);
}

at("part").addEventListener("change", () => { keep({ part: at("part").value || "all" }); shown = looked = null; drawCompare(); });
for (const button of document.querySelectorAll(".compare [data-zoom]")) button.addEventListener("click", () => zoomBy(button.dataset.zoom));

export function repaintCompare() {
  for (const plot of Object.values(plots)) plot.repaint();
}
export { chosen };
