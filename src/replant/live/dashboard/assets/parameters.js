// The parameters over the whole run, one small plot for each.
import { known, lowered, tick, timeLabel, uncertain } from "./format.js";
import { chart, colour, edge, extent, line, seen, steady, ticksOf, truth } from "./chart.js";
import { element } from "./served.js";
import { TIMES } from "./span.js";

/** One small plot a parameter, over the whole run. */
export function parameterPlots(room, span) {
  let names = "", small = [];
  const build = view => {
    names = view.names.join(" ");
    for (const { one } of small) one.plot.destroy();
    room.replaceChildren();
    small = view.names.map((name, i) => parameterPlot(room, name, i, span));
  };
  return {
    get charts() { return small.map(({ one }) => one); },
    draw(view, history) {
      if (view.names.join(" ") !== names) build(view);
      small.forEach(({ draw }) => draw(view, history));
    },
  };
}

function parameterPlot(room, name, i, span) {
  const value = element("b"), std = element("small"), said = `Parameter ${name} over the whole run, with a band of two standard deviations`;
  const place = element("div", { class: "plot small", role: "img", "aria-label": said });
  room.append(element("figure", {}, element("figcaption", {}, element("h3", { title: name }, lowered(name)), value, std), place));
  const fit = steady(0.1, 0.4);
  let ends = [0, 1], at = [0, 1], rows = [[], [], [], [], []], now = [null, null];
  const one = chart(place, {
    series: [line("residual"), truth(), edge(), edge()], bands: [{ series: [3, 4], fill: () => colour("residual") + "40" }],
    x: { incrs: TIMES, space: 48, values: (_, ticks) => ticks.map(t => timeLabel(t, ends[1] - ends[0])) },
    y: { size: 56, space: 30, values: ticksOf(tick) }, cursor: "run", choose: span.zoom.set, limits: () => [ends, at],
    read: j => {
      const [text, spread] = j === null ? uncertain(now[0], now[1]) : uncertain(rows[1][j], (rows[3][j] - rows[1][j]) / 2);
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
    const real = view.truth?.parameters?.[i];
    rows = [t, theta, t.map(() => real ?? null), shifted(2), shifted(-2)];
    now = [view.parameters[i], view.std[i]];
    const first = t[0] ?? 0;
    ends = span.of(first, Math.max(view.at ?? 1, first + 1e-3), false);
    ends[0] = Math.max(ends[0], first);
    const settled = ends[0] > first ? 0 : Math.floor(theta.length / 5); // the estimate varies most at the beginning, which may leave the picture
    at = fit(...extent(...rows.slice(1).map(column => seen(t.slice(settled), ends, column.slice(settled)))));
    one.draw(rows);
  };
  return { one, draw };
}
