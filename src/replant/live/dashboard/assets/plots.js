// The plots over time and frequency, drawn by uPlot; limits change seldom, so that the axes stand still.
import { known, lowered, number, tick, timeLabel, uncertain } from "./format.js";

const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "Liberation Sans", sans-serif';
const SPANS = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 86400];
const TIMES = [1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600,
  7200, 14400, 28800, 86400, 172800, 432000, 864000];
const DEGREES = [1, 5, 10, 15, 30, 45, 90, 180, 360];

let palette = {};
/** Read the colours of the style sheet again, as after a change from light to dark. */
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const role of ["ink", "muted", "grid", "measured", "model", "input", "residual", "accent", "shade"]) {
    palette[role] = style.getPropertyValue("--" + role).trim();
  }
}
export const colour = role => palette[role];

/** Limits that hold all values, kept from one drawing to the next while they still fit. */
export function steady(room = 0.08, keep = 0.55) {
  let held = null;
  return (low, high) => {
    if (!known(low) || !known(high)) return held ?? [0, 1];
    const size = Math.max(Math.abs(low), Math.abs(high));
    const width = high - low > 1e-7 * size ? high - low : 1e-3 * size || 1; // a constant gets some room
    const fits = held && low >= held[0] && high <= held[1] && width >= keep * (held[1] - held[0]);
    if (!fits) {
      const middle = (low + high) / 2, half = width * (0.5 + room);
      held = [middle - half, middle + half];
    }
    return held;
  };
}

function extent(...columns) {
  let low = Infinity, high = -Infinity;
  for (const column of columns) {
    for (const value of column ?? []) {
      if (!known(value)) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  return low <= high ? [low, high] : [null, null];
}

/** Whether at least half of one range lies inside another: a set-point then belongs beside the output that follows it. */
function shares([low, high], [from, to]) {
  if (low === null || from === null) return true;
  return low === high ? low >= from && low <= to : Math.min(high, to) - Math.max(low, from) >= 0.5 * (high - low);
}

const line = (role, more = {}) => ({ stroke: () => colour(role), width: 1.5, points: { show: false }, spanGaps: false, ...more });
const edge = () => ({ stroke: "transparent", width: 0, points: { show: false } });
const axis = more => ({ stroke: () => colour("muted"), font: FONT, gap: 4, ticks: { show: false },
  grid: { stroke: () => colour("grid"), width: 1 }, ...more });

/** Shade the stretches that verdict, fit and offset leave out, behind the curves. */
function shade({ ctx, bbox, valToPos }, spans) {
  ctx.save();
  ctx.fillStyle = colour("shade");
  for (const [begin, end] of spans) {
    const from = Math.max(valToPos(begin, "x", true), bbox.left), to = Math.min(valToPos(end, "x", true), bbox.left + bbox.width);
    if (to > bbox.left && from < bbox.left + bbox.width) ctx.fillRect(from, bbox.top, Math.max(to - from, devicePixelRatio), bbox.height);
  }
  ctx.restore();
}

/**
 * A uPlot in a room of the page whose size the style sheet sets.
 * leftOut(): from when to when samples take no part, which is shaded;
 * limits(): [x, y] limits as of now; read(i): writes the values at index i, or the newest for null, into the legend.
 */
function chart(room, { series, bands = [], x, y, limits, cursor, read, log = false, leftOut = () => [] }) {
  const plot = new uPlot({
    width: room.clientWidth, height: room.clientHeight, legend: { show: false }, padding: [6, 18, 0, 0],
    scales: {
      x: { time: false, auto: false, distr: log ? 3 : 1, range: () => limits()[0] },
      y: { auto: false, range: () => limits()[1] },
    },
    axes: [axis({ size: 22, space: 60, ...x }), axis({ size: 50, space: 26, ...y })],
    series: [{}, ...series], bands,
    cursor: { y: false, drag: { x: false, y: false }, points: { size: 5 }, ...(cursor ? { sync: { key: cursor, scales: ["x", null] } } : {}) },
    hooks: { setCursor: [plot => read(plot.cursor.idx ?? null)], drawClear: [plot => shade(plot, leftOut())] },
  }, [[], ...series.map(() => [])], room);
  new ResizeObserver(() => {
    const { clientWidth: width, clientHeight: height } = room;
    if (width && height && (width !== plot.width || height !== plot.height)) plot.setSize({ width, height });
  }).observe(room);
  return {
    plot,
    draw(data) {
      plot.batch(() => {
        plot.setData(data, false);
        plot.setScale("x", {});
        plot.setScale("y", {});
        plot.redraw(true, true);
      });
      read(plot.cursor.idx ?? null);
    },
    repaint: () => plot.redraw(false, true),
  };
}

/** The legend of a plot: a swatch, a name and a value for each entry. */
export function legend(place, entries) {
  const values = entries.map(({ role, label, kind = "" }) => {
    const item = document.createElement("span"), swatch = document.createElement("i"), value = document.createElement("b");
    swatch.className = kind;
    swatch.style.borderColor = `var(--${role})`;
    item.append(swatch, label ? label + " " : "", value);
    place.append(item);
    return value;
  });
  return (...texts) => texts.forEach((text, i) => { if (values[i].textContent !== text) values[i].textContent = text; });
}

const ticksOf = format => (_, ticks) => ticks.map(format);

/** Measured and simulated output, and the input, over the newest samples; time counts back from the newest. */
export function timePlots() {
  const say = { output: legend(document.querySelector('[data-for="output"]'), [{ role: "measured", label: "measured", kind: "thick" },
    { role: "model", label: "simulated" }, { role: "muted", label: "reference", kind: "dashed" }, { role: "shade", label: "left out", kind: "shade" }]),
    reference: legend(document.querySelector('[data-for="reference"]'), [{ role: "muted", label: "" }]),
    input: legend(document.querySelector('[data-for="input"]'), [{ role: "input", label: "" }]) };
  const keyOf = kind => document.querySelector(`[data-for="output"] i.${kind}`).parentElement;
  const shadeKey = keyOf("shade"), referenceKey = keyOf("dashed"), apart = document.getElementById("apart");
  const fit = { output: steady(), reference: steady(), input: steady() };
  let span = 1, at = { output: [0, 1], reference: [0, 1], input: [0, 1] }, shown = [[], [], [], [], []], leftOut = [];
  const newest = (column, i) => number(column[i ?? column.length - 1], 4);
  const output = chart(document.getElementById("output"), {
    series: [line("measured", { width: 2.25 }), line("model", { width: 1.75 }), line("muted", { width: 1.25, dash: [5, 3] })],
    x: { size: 6, values: (_, ticks) => ticks.map(() => "") }, y: { values: ticksOf(tick) }, cursor: "time",
    limits: () => [[-span, 0], at.output], leftOut: () => leftOut,
    read: i => say.output(newest(shown[2], i), newest(shown[3], i), newest(shown[4], i)),
  });
  const reference = chart(document.getElementById("reference"), { // of one that is not of the size of the output, as a dither
    series: [line("muted", { width: 1.25 })],
    x: { size: 6, values: (_, ticks) => ticks.map(() => "") }, y: { values: ticksOf(tick) }, cursor: "time",
    limits: () => [[-span, 0], at.reference], leftOut: () => leftOut, read: i => say.reference(newest(shown[4], i)),
  });
  const input = chart(document.getElementById("input"), {
    series: [line("input", { width: 1.25, paths: uPlot.paths.stepped({ align: 1 }) })],
    x: { incrs: TIMES, values: (_, ticks) => ticks.map(t => (t ? timeLabel(t, 0) : "now")) }, y: { values: ticksOf(tick) },
    cursor: "time", limits: () => [[-span, 0], at.input], leftOut: () => leftOut, read: i => say.input(newest(shown[1], i)),
  });
  return {
    charts: [output, reference, input],
    draw({ window }) {
      const end = window.t.at(-1) ?? 0, t = window.t.map(value => value - end), length = t.length ? -t[0] : 1;
      span = SPANS.find(candidate => candidate >= 0.97 * length) ?? length;
      const r = window.r ?? [], follows = shares(extent(r), extent(window.y));
      shown = [t, window.u, window.y, window.model, r];
      referenceKey.hidden = !r.length || !follows;
      apart.hidden = !r.length || follows;
      leftOut = (window.left_out ?? []).map(stretch => stretch.map(value => value - end));
      shadeKey.hidden = !leftOut.length;
      const [low, high] = extent(window.y), all = extent(window.y, window.model), room = 0.5 * (high - low);
      // the limits follow the measured output alone: a diverging model leaves the picture
      const beside = follows && r.length ? extent(r) : [null, null];
      const ends = low === null ? all : [Math.max(all[0], low - room), Math.min(all[1], high + room)];
      at.output = fit.output(...(beside[0] === null ? ends : [Math.min(ends[0] ?? beside[0], beside[0]), Math.max(ends[1] ?? beside[1], beside[1])]));
      at.input = fit.input(...extent(window.u));
      at.reference = fit.reference(...extent(r));
      output.draw([t, window.y, window.model, r.length && follows ? r : t.map(() => null)]);
      reference.draw([t, r.length ? r : t.map(() => null)]);
      input.draw([t, window.u]);
    },
  };
}

const isDecade = value => value > 0 && Math.abs(value / 10 ** Math.round(Math.log10(value)) - 1) < 1e-6;

/** Lines at 1, 2 and 5 of every decade. */
function logTicks(_, axis, low, high) {
  const found = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
    for (const m of [1, 2, 5]) if (m * 10 ** power >= 0.999 * low && m * 10 ** power <= 1.001 * high) found.push(m * 10 ** power);
  }
  return found;
}

/** Magnitude with its band, and phase. */
export function bodePlots() {
  const say = { magnitude: legend(document.querySelector('[data-for="magnitude"]'), [{ role: "model", label: "" }]),
    phase: legend(document.querySelector('[data-for="phase"]'), [{ role: "model", label: "" }]) };
  document.querySelectorAll('[data-for="magnitude"] i, [data-for="phase"] i').forEach(swatch => swatch.remove());
  const fit = { magnitude: steady(), phase: steady() };
  let ends = [0.1, 10], at = { magnitude: [-40, 10], phase: [-180, 0] }, shown = { omega: [], magnitude_db: [], phase_deg: [] };
  const decades = (_, ticks) => ticks.map(value => (isDecade(value) ? tick(value) : ""));
  const where = i => (i === null ? "" : `at ${number(shown.omega[i], 3)} rad/s`);
  const magnitude = chart(document.getElementById("magnitude"), {
    series: [line("model"), edge(), edge()], bands: [{ series: [2, 3], fill: () => colour("model") + "40" }], log: true,
    x: { size: 6, splits: logTicks, filter: (_, ticks) => ticks, values: (_, ticks) => ticks.map(() => "") }, y: { values: ticksOf(tick) }, cursor: "frequency",
    limits: () => [ends, at.magnitude], read: i => say.magnitude(i === null ? "dB" : `${number(shown.magnitude_db[i], 3)} dB ${where(i)}`),
  });
  const phase = chart(document.getElementById("phase"), {
    series: [line("model")], log: true, x: { splits: logTicks, filter: (_, ticks) => ticks, values: decades }, y: { incrs: DEGREES, values: ticksOf(tick) },
    cursor: "frequency", limits: () => [ends, at.phase],
    read: i => say.phase(i === null ? "degrees over rad/s" : `${number(shown.phase_deg[i], 3)}° ${where(i)}`),
  });
  return {
    charts: [magnitude, phase],
    draw({ bode }) {
      shown = bode;
      if (bode.omega.length > 1) ends = [bode.omega[0], bode.omega.at(-1)];
      const [low, high] = extent(bode.magnitude_db), band = extent(bode.magnitude_db, bode.magnitude_low, bode.magnitude_high);
      if (low !== null) at.magnitude = fit.magnitude(Math.max(band[0], low - 12), Math.min(band[1], high + 12));
      at.phase = fit.phase(...extent(bode.phase_deg));
      magnitude.draw([bode.omega, bode.magnitude_db, bode.magnitude_high, bode.magnitude_low]);
      phase.draw([bode.omega, bode.phase_deg]);
    },
  };
}

/** One small plot a parameter, over the whole run. */
export function parameterPlots(room) {
  let names = "", small = [];
  const build = view => {
    names = view.names.join(" ");
    for (const { one } of small) one.plot.destroy();
    room.replaceChildren();
    small = view.names.map((name, i) => parameterPlot(room, name, i));
  };
  return {
    get charts() { return small.map(({ one }) => one); },
    draw(view, history) {
      if (view.names.join(" ") !== names) build(view);
      small.forEach(({ draw }) => draw(view, history));
    },
  };
}

function parameterPlot(room, name, i) {
  const figure = document.createElement("figure"), head = document.createElement("figcaption"), place = document.createElement("div");
  const title = document.createElement("h3"), value = document.createElement("b"), std = document.createElement("small");
  title.textContent = lowered(name);
  head.append(title, value, std);
  place.className = "plot small";
  place.setAttribute("role", "img");
  place.setAttribute("aria-label", `Parameter ${name} over the whole run, with a band of two standard deviations`);
  figure.append(head, place);
  room.append(figure);
  const fit = steady(0.1, 0.4);
  let ends = [0, 1], at = [0, 1], rows = [[], [], [], []], now = [null, null];
  const one = chart(place, {
    series: [line("residual"), edge(), edge()], bands: [{ series: [2, 3], fill: () => colour("residual") + "40" }],
    x: { incrs: TIMES, space: 48, values: (_, ticks) => ticks.map(t => timeLabel(t, ends[1] - ends[0])) },
    y: { size: 56, space: 30, values: ticksOf(tick) }, cursor: "run", limits: () => [ends, at],
    read: j => {
      const [text, spread] = j === null ? uncertain(now[0], now[1]) : uncertain(rows[1][j], (rows[2][j] - rows[1][j]) / 2);
      value.textContent = text;
      std.textContent = spread + (j === null ? "" : ` at ${timeLabel(rows[0][j], ends[1] - ends[0])}`);
    },
  });
  const draw = (view, history) => {
    // before the first model all values are zero
    const theta = history.parameters.map(row => (row.some(v => v !== 0) ? row[i] : null)), spread = history.std.map(row => row[i]), t = [...history.t];
    if (view.at > t.at(-1)) { // histories are sent less often
      theta.push(view.parameters[i]);
      spread.push(view.std[i]);
      t.push(view.at);
    }
    const shifted = sign => theta.map((v, j) => (known(v) && known(spread[j]) ? v + sign * spread[j] : null));
    rows = [t, theta, shifted(2), shifted(-2)];
    now = [view.parameters[i], view.std[i]];
    ends = [t[0] ?? 0, Math.max(view.at ?? 1, (t[0] ?? 0) + 1e-3)];
    const settled = Math.floor(theta.length / 5); // the estimate varies most at the beginning, which may leave the picture
    at = fit(...extent(...rows.slice(1).map(column => column.slice(settled))));
    one.draw(rows);
  };
  return { one, draw };
}
