// The time plots of a report on one common time axis, zoomed by mouse, keyboard and buttons.
import { tick } from "./format.js";
import { chart, colour, edge, extent, legend, line, readColours, seen, zoomed, zoomKeys } from "./chart.js";

const plans = Object.values(JSON.parse(document.getElementById("data").textContent)).flat();

// base64 of little-endian numbers; NaN leaves a gap
const unpack = (text, size, get, offset = 0) => {
  const view = new DataView(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
  return Array.from({ length: view.byteLength / size }, (_, i) => {
    const value = view[get](size * i, true);
    return Number.isNaN(value) ? null : value + offset;
  });
};
/** When the points of a plan are: evenly spaced, or of an irregular clock. */
const timesOf = ({ times, count, start, step }) => (times ? unpack(times, 8, "getFloat64")
  : Array.from({ length: count }, (_, i) => start + step * i));
const decade = value => {
  const power = Math.round(value);
  return Math.abs(value - power) > 1e-6 ? tick(10 ** value, 2) : Math.abs(power) < 4 ? tick(10 ** power, 6) : tick(10 ** power, 4).replace(/^1×/, "");
};
/** How a curve of a plan is drawn. */
const lookOf = ({ role, kind }) => {
  if (kind === "constant") return line(role, { dash: [6, 4] });
  if (role === "measured") return line(role, { width: 3 });
  return line(role, kind === "step" ? { width: 1.25, paths: uPlot.paths.stepped({ align: 1 }) } : {});
};

/** The columns of a plan, how they are drawn, and in which of them each of its curves stands. */
function assemble(plan) {
  const t = timesOf(plan), data = [t], series = [], bands = [], places = [];
  for (const { kind, value, role, data: packed, offset } of plan.curves) {
    places.push(data.length);
    const values = kind === "constant" ? t.map(() => value) : unpack(packed, 4, "getFloat32", offset);
    if (kind === "band") {
      for (const sign of [2, -2]) {
        data.push(data[1].map((middle, i) => (middle === null || values[i] === null ? null : middle + sign * values[i])));
        series.push(edge());
      }
      bands.push({ series: [data.length - 2, data.length - 1], fill: () => colour(role) + "38" });
    } else {
      data.push(values);
      series.push(lookOf({ role, kind }));
    }
  }
  for (const gap of plan.gaps || []) { // no line runs through a gap
    const at = t.findIndex(value => value > gap);
    if (at > 0) data.forEach((column, i) => column.splice(at, 0, i ? null : gap));
  }
  return { data, series, bands, places };
}

/** The legend of a plan; returns what writes the values at a point of time. */
function keyOf(plan, place) {
  const { curves } = plan, several = curves.length > 1 && !plan.quiet, shown = plan.quiet ? curves.slice(0, 1) : curves;
  const entries = shown.map(({ role, label, kind }) => ({ role, label: several ? label : "", kind }));
  if (plan.left_out?.length && several) entries.push({ role: "shade", label: "left out", kind: "shade" });
  const say = legend(place, entries);
  if (!several) place.querySelector("i").remove();
  return say;
}

function draw() {
  const made = plans.map(plan => ({ plan, room: document.getElementById(plan.name), ...assemble(plan) }));
  const whole = made.reduce(([low, high], { data: [t] }) => (t.length ? [Math.min(low, t[0]), Math.max(high, t.at(-1))] : [low, high]), [0, 0]);
  if (whole[0] === whole[1]) whole[1] = whole[0] + 1;
  let range = whole;

  const show = chosen => {
    const [low, high] = chosen ?? whole, width = Math.min(Math.max(high - low, 1e-6 * (whole[1] - whole[0])), whole[1] - whole[0]);
    const start = Math.min(Math.max(low, whole[0]), whole[1] - width);
    range = chosen ? [start, start + width] : whole;
    const digits = Math.min(15, 3 + Math.ceil(Math.log10(Math.max(Math.abs(range[1]) / width, 1))));
    document.querySelector(".range").textContent = `${tick(range[0], digits)} … ${tick(range[1], digits)} s`;
    for (const each of made) each.chart.draw(each.data);
  };
  const zoomBy = how => show(zoomed(range, how, whole));

  /** The limits of y: the prepared ones while the whole time is shown, else those of the visible samples. */
  const fitted = ({ plan, data }) => {
    if (plan.limits && range === whole) return plan.limits;
    const [low, high] = extent(...data.slice(1).map(column => seen(data[0], range, column)));
    if (low === null) return plan.limits || [0, 1];
    const space = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
    return [low - space, high + space];
  };

  for (const each of made) {
    const { plan, room, data, series, bands, places } = each, decades = plan.curves[0].kind === "decades";
    const say = keyOf(plan, room.parentElement.querySelector(".legend"));
    const text = (curve, value) => (value === null || curve.kind === "band" ? "" : decades ? tick(10 ** value, 3) : tick(value, 5));
    each.chart = chart(room, {
      series, bands, cursor: "time", choose: show, right: 28, limits: () => [range, fitted(each)], leftOut: () => plan.left_out || [],
      x: { size: 26, space: 70, values: (_, ticks) => ticks.map(t => `${tick(t)} s`) },
      y: { size: 66, gap: 6, incrs: decades ? [0.1, 0.2, 0.5, 1, 2, 3, 4, 5, 10] : undefined,
        values: (_, ticks) => ticks.map(value => (decades ? decade(value) : tick(value, 6))) },
      read: i => say(...plan.curves.slice(0, plan.quiet ? 1 : undefined).map((curve, k) => (i === null ? "" : text(curve, data[places[k]][i] ?? null)))),
    });
    zoomKeys(room, zoomBy);
    room.addEventListener("wheel", event => {
      if (!event.ctrlKey) return;
      event.preventDefault();
      zoomBy(event.deltaY < 0 ? "in" : "out");
    }, { passive: false });
  }
  show(null);
  for (const button of document.querySelectorAll("[data-do]")) button.addEventListener("click", () => zoomBy(button.dataset.do));
  return made.map(each => each.chart);
}

if (plans.length) {
  document.documentElement.classList.add("script");
  readColours();
  let charts;
  try {
    charts = draw();
  } catch (error) { // the static pictures take their place
    document.documentElement.classList.remove("script");
    throw error;
  }
  addEventListener("beforeprint", () => document.querySelectorAll(".fold").forEach(fold => { fold.open = true; }));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    readColours();
    for (const each of charts) each.repaint();
  });
  window.replantCharts = charts.map(each => each.plot);
}
