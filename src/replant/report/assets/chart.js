// What all plots share: a uPlot in its room, colours, limits that stand still, zoom by dragging, and a legend.
import { known, tick } from "./format.js";

const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "Liberation Sans", sans-serif';
const CLICK = 6; // pixels below which a drag is a click

let palette = {};
/** Read the colours of the style sheet again, as after a change from light to dark. */
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const role of ["ink", "muted", "grid", "measured", "model", "input", "residual", "accent", "shade", "truth", "line-3", "line-4", "good",
    "warn", "bad"]) {
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

export function extent(...columns) {
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

export const line = (role, more = {}) => ({ stroke: () => colour(role), width: 1.5, points: { show: false }, spanGaps: false, ...more });
/** The true value, of a simulated plant. */
export const truth = () => line("truth", { width: 1.25, dash: [5, 4] });
export const edge = () => ({ stroke: "transparent", width: 0, points: { show: false } });
const axis = more => ({ stroke: () => colour("muted"), font: FONT, gap: 4, ticks: { show: false },
  grid: { stroke: () => colour("grid"), width: 1 }, ...more });

/** Shade stretches behind the curves: those that verdict, fit and offset leave out, or others in the colour of a role. */
function shade({ ctx, bbox, valToPos }, spans) {
  ctx.save();
  for (const [begin, end, role] of spans) {
    ctx.fillStyle = role ? colour(role) + "30" : colour("shade");
    const from = Math.max(valToPos(begin, "x", true), bbox.left), to = Math.min(valToPos(end, "x", true), bbox.left + bbox.width);
    if (to > bbox.left && from < bbox.left + bbox.width) ctx.fillRect(from, bbox.top, Math.max(to - from, devicePixelRatio), bbox.height);
  }
  ctx.restore();
}

let dragged = false;
addEventListener("mouseup", () => { dragged = false; });
/** Whether a stretch is being chosen on a plot, which must not move meanwhile. */
export const dragging = () => dragged;

/** A stretch of the x-axis that was chosen by dragging on one of several plots; null shows everything. */
export function zoom(changed) {
  let range = null;
  const set = chosen => { range = chosen; changed(); };
  return { get range() { return range; }, set, reset: () => { if (range) set(null); } };
}

/** The part of a column that lies within a stretch of x, so that limits fit what is seen. */
export function seen(x, [from, to], column) {
  const first = x.findIndex(value => value >= from), beyond = x.findIndex(value => value > to);
  return first < 0 ? [] : (column ?? []).slice(first, beyond < 0 ? undefined : beyond);
}

/**
 * A uPlot in a room of the page whose size the style sheet sets.
 * leftOut(): from when to when samples take no part, which is shaded;
 * limits(): [x, y] limits as of now; read(i): writes the values at index i, or the newest for null, into the legend;
 * choose(range): a stretch of x was chosen by dragging, or none by a double click.
 */
export function chart(room, { series, bands = [], x, y, limits, cursor, read, choose, log = false, leftOut = () => [], right = 18 }) {
  const plot = new uPlot({
    width: room.clientWidth, height: room.clientHeight, legend: { show: false }, padding: [6, right, 0, 0],
    pxAlign: 0, // lines between pixels: on whole ones a slope becomes stairs
    scales: {
      x: { time: false, auto: false, distr: log ? 3 : 1, range: () => limits()[0] },
      y: { auto: false, range: () => limits()[1] },
    },
    axes: [axis({ size: 22, space: 60, ...x }), axis({ size: 50, space: 26, ...y })],
    series: [{}, ...series.map(each => ({ pxAlign: 0, ...each }))], bands,
    cursor: { y: false, drag: { x: true, y: false, setScale: false, dist: CLICK }, points: { size: 5 },
      bind: { dblclick: () => () => choose(null) }, ...(cursor ? { sync: { key: cursor, scales: ["x", null], setSeries: false, filters: { pub: kind => kind === "mousemove" || kind === "mouseleave" } } } : {}) },
    hooks: { setCursor: [plot => read(plot.cursor.idx ?? null)], drawClear: [plot => shade(plot, leftOut())], setSelect: [plot => {
      const { left, width } = plot.select;
      if (!width) return;
      plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
      dragged = false;
      if (width >= CLICK) choose([plot.posToVal(left, "x"), plot.posToVal(left + width, "x")]);
    }] },
  }, [[], ...series.map(() => [])], room);
  plot.over.addEventListener("mousedown", event => { dragged = event.button === 0; });
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

export const ticksOf = format => (_, ticks) => ticks.map(value => format(value));
export const unlabelled = { size: 6, values: (_, ticks) => ticks.map(() => "") };
export const labelled = { values: ticksOf(tick) };

/** Keys of a plot over time: arrows pan, plus and minus zoom, Escape and Home show everything. */
export function zoomKeys(room, zoomBy) {
  const keys = { ArrowLeft: "left", ArrowRight: "right", "+": "in", "=": "in", "-": "out", Escape: "all", Home: "all" };
  room.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys) || event.target !== room) return;
    event.preventDefault();
    zoomBy(keys[event.key]);
  });
}

/** A stretch that is zoomed, panned, or shown as a whole. */
export function zoomed([from, to], how, [first, last]) {
  const width = to - from;
  let next = { in: [from + width / 4, to - width / 4], out: [from - width / 2, to + width / 2],
    left: [from - width / 5, to - width / 5], right: [from + width / 5, to + width / 5] }[how];
  if (!next) return null;
  const wide = Math.min(next[1] - next[0], last - first), start = Math.min(Math.max(next[0], first), last - wide);
  return wide >= last - first ? null : [start, start + wide];
}
