// Curves: least and greatest values as strokes, the colours of the models, and plots of several models.
import { chart, colour, edge, extent, labelled, line, seen, steady } from "/assets/chart.js";
import { timeLabel } from "/assets/format.js";
import { TIMES } from "/assets/span.js";

/** The colours of the palette that models have, by their place among those compared. */
export const ROLES = ["model", "residual", "input", "line-3", "line-4", "ink"];

/** A thinned signal as two points for each place, its least and its greatest value; as it is where all samples are shown. */
export function strokes(t, low, high) {
  if (!high) return [t, low];
  const x = new Array(2 * t.length), y = new Array(2 * t.length);
  for (let i = 0; i < t.length; i++) {
    const down = i % 2; // so that the line between two strokes is short
    x[2 * i] = x[2 * i + 1] = t[i];
    y[2 * i] = down ? high[i] : low[i];
    y[2 * i + 1] = down ? low[i] : high[i];
  }
  return [x, y];
}

/** Two curves with places of their own on one axis; undefined, unlike null, leaves no gap. */
export function merged(x, y, ax, ay) {
  const places = [], one = [], other = [];
  for (let i = 0, k = 0; i < x.length || k < ax.length;) {
    if (k >= ax.length || x[i] <= ax[k]) { places.push(x[i]); one.push(y[i++]); other.push(undefined); }
    else { places.push(ax[k]); one.push(undefined); other.push(ay[k++]); }
  }
  return [places, one, other];
}

export const timeAxis = span => ({ incrs: TIMES, values: (_, ticks) => ticks.map(t => timeLabel(t, span())) });

/**
 * A plot of a curve for each model, with a band each; more(): further series before them.
 * draw(x, curves, before): curves by place { y, low, high }.
 */
export function manyCurves(room, { x, y = labelled, log = false, first = [], range, choose, cursor, leftOut, read, limit, dashed = false }) {
  const fit = steady();
  let ends = log ? [0.1, 10] : [0, 1], limits = [0, 1], shown = [[]];
  const series = [...first, ...ROLES.flatMap(role => [line(role, { width: 1.6, alpha: 0.85 }), edge(), edge()])];
  if (dashed) series.forEach((each, i) => { if (i >= first.length && (i - first.length) % 3) Object.assign(each, line(ROLES[Math.floor((i - first.length) / 3)], { dash: [5, 4], width: 1 })); });
  const bands = dashed ? [] : ROLES.map((role, i) => ({ series: [first.length + 3 * i + 2, first.length + 3 * i + 3], fill: () => colour(role) + "30" }));
  const made = chart(room, { series, bands, x, y, log, cursor, choose: choose ?? (() => {}), leftOut: leftOut ?? (() => []),
    limits: () => [range?.() ?? ends, limits], read: i => read?.(i, shown) });
  return {
    ...made,
    draw(across, curves, before = [], tall = null) {
      const none = across.map(() => null);
      if (across.length > 1 && across.at(-1) > across[0]) ends = [across[0], across.at(-1)];
      const columns = ROLES.flatMap((_, i) => {
        const curve = curves[i];
        return curve ? [curve.y, curve.high ?? none, curve.low ?? none] : [none, none, none];
      });
      shown = [across, ...before, ...columns];
      const inside = column => seen(across, range?.() ?? ends, column);
      limits = tall ?? fit(...limit(curves.filter(Boolean), inside, before));
      made.draw(shown);
    },
  };
}

/** Limits that follow the curves, and bands only as far as these do not hide them. */
export function curveLimits(curves, inside) {
  const [low, high] = extent(...curves.map(each => inside(each.y)));
  if (low === null) return [0, 1];
  const room = 0.6 * (high - low || Math.abs(high) || 1), [least] = extent(...curves.map(each => inside(each.low))), [, most] = extent(...curves.map(each => inside(each.high)));
  return [Math.max(least ?? low, low - room), Math.min(most ?? high, high + room)];
}
