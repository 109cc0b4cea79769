// The time plots, drawn by uPlot on one common time axis, zoomed by mouse, keyboard and buttons.
(() => {
  "use strict";
  const sections = JSON.parse(document.getElementById("data").textContent);
  const plans = Object.values(sections).flat();
  if (!plans.length) return;
  document.documentElement.classList.add("script");

  const colour = role => getComputedStyle(document.documentElement).getPropertyValue("--" + role).trim();
  const superscript = n => String(n).replace(/[-0-9]/g, c => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
  const plain = (value, digits) => {
    if (value == null || !isFinite(value)) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-4 || size >= 1e6)) {
      const [mantissa, exponent] = value.toExponential(Math.max(0, Math.min(digits, 4) - 1)).split("e");
      return String(+mantissa).replace("-", "−") + "×10" + superscript(+exponent);
    }
    return String(+value.toPrecision(digits)).replace("-", "−");
  };
  const decade = value => {
    const power = Math.round(value);
    if (Math.abs(value - power) > 1e-6) return plain(10 ** value, 2);
    return Math.abs(power) < 4 ? plain(10 ** power, 6) : "10" + superscript(power);
  };

  // base64 of little-endian float32 to numbers; null leaves a gap
  const unpack = curve => {
    const bytes = Uint8Array.from(atob(curve.data), c => c.charCodeAt(0));
    const view = new DataView(bytes.buffer), values = new Array(bytes.length / 4);
    for (let i = 0; i < values.length; i++) {
      const value = view.getFloat32(4 * i, true);
      values[i] = Number.isNaN(value) ? null : value + curve.offset;
    }
    return values;
  };

  // when the points of a plan are: evenly spaced, or of an irregular clock base64 of little-endian float64
  for (const plan of plans) {
    if (!plan.times) plan.when = Array.from({ length: plan.count }, (_, i) => plan.start + plan.step * i);
    else {
      const view = new DataView(Uint8Array.from(atob(plan.times), c => c.charCodeAt(0)).buffer);
      plan.when = Array.from({ length: view.byteLength / 8 }, (_, i) => view.getFloat64(8 * i, true));
    }
  }

  const full = plans.reduce((range, plan) => {
    const [first, last] = plan.count ? [plan.when[0], plan.when[plan.count - 1]] : [plan.start, plan.start];
    return [Math.min(range[0], first), Math.max(range[1], last)];
  }, [0, 0]);
  if (full[0] === full[1]) full[1] = full[0] + 1;
  let shown = full;
  const made = [];

  const show = (low, high) => {
    const width = Math.min(Math.max(high - low, 1e-6 * (full[1] - full[0])), full[1] - full[0]);
    const start = Math.min(Math.max(low, full[0]), full[1] - width);
    shown = [start, start + width];
    for (const chart of made) chart.setScale("x", { min: shown[0], max: shown[1] });
    const digits = Math.min(15, 3 + Math.ceil(Math.log10(Math.max(Math.abs(shown[1]) / width, 1))));
    document.querySelector(".range").textContent = plain(shown[0], digits) + " … " + plain(shown[1], digits) + " s";
  };
  const actions = {
    all: () => show(...full),
    in: () => { const quarter = (shown[1] - shown[0]) / 4; show(shown[0] + quarter, shown[1] - quarter); },
    out: () => { const half = (shown[1] - shown[0]) / 2; show(shown[0] - half, shown[1] + half); },
    left: () => { const step = (shown[1] - shown[0]) / 5; show(shown[0] - step, shown[1] - step); },
    right: () => { const step = (shown[1] - shown[0]) / 5; show(shown[0] + step, shown[1] + step); },
  };
  const keys = { ArrowLeft: "left", ArrowRight: "right", "+": "in", "=": "in", "-": "out", Escape: "all", Home: "all" };

  // the limits of y: the prepared ones while the whole time is shown, else those of the visible samples
  const fitted = plan => (chart, low, high) => {
    if (plan.limits && shown[0] === full[0] && shown[1] === full[1]) return plan.limits;
    if (low == null || !isFinite(low) || !isFinite(high)) return plan.limits || [0, 1];
    const room = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
    return [low - room, high + room];
  };

  const series = curve => {
    const stroke = () => colour(curve.role);
    const look = { stroke, points: { show: false }, spanGaps: false, label: curve.label };
    if (curve.kind === "constant") return { ...look, width: 1.5, dash: [6, 4] };
    if (curve.role === "measured") return { ...look, width: 3 };
    if (curve.kind === "step") return { ...look, width: 1.25, paths: uPlot.paths.stepped({ align: 1 }) };
    return { ...look, width: 1.5 };
  };

  const assemble = plan => {
    const first = unpack(plan.curves[0]);
    const data = [plan.when, first], drawn = [{}, series(plan.curves[0])], bands = [];
    for (const curve of plan.curves.slice(1)) {
      if (curve.kind === "constant") {
        data.push(first.map(() => curve.value));
        drawn.push(series(curve));
      } else if (curve.kind === "band") {
        const std = unpack(curve), edge = { stroke: "transparent", width: 0, points: { show: false } };
        for (const sign of [2, -2]) {
          data.push(first.map((value, i) => (value == null || std[i] == null ? null : value + sign * std[i])));
          drawn.push({ ...edge });
        }
        bands.push({ series: [data.length - 2, data.length - 1], fill: () => colour(curve.role) + "38" });
      } else {
        data.push(unpack(curve));
        drawn.push(series(curve));
      }
    }
    for (const gap of plan.gaps || []) { // no line runs through a gap
      const at = data[0].findIndex(t => t > gap);
      if (at > 0) data.forEach((row, i) => row.splice(at, 0, i ? null : gap));
    }
    return { data, drawn, bands };
  };

  const key = (plan, legend) => plan.curves.map(curve => {
    const item = document.createElement("span"), swatch = document.createElement("i"), value = document.createElement("b");
    swatch.className = curve.kind;
    swatch.style.borderColor = "var(--" + curve.role + ")";
    if (plan.quiet && curve !== plan.curves[0]) return value;
    if (plan.curves.length > 1 && !plan.quiet) item.append(swatch, curve.label + " ");
    item.append(value);
    legend.append(item);
    return value;
  });

  // shade the samples that fit and offset leave out, behind the curves
  const shade = plan => chart => {
    const { ctx, bbox } = chart, [low, high] = [bbox.left, bbox.left + bbox.width];
    ctx.save();
    ctx.fillStyle = colour("shade");
    for (const [begin, end] of plan.left_out) {
      const from = Math.max(chart.valToPos(begin, "x", true), low), to = Math.min(chart.valToPos(end, "x", true), high);
      if (to > low && from < high) ctx.fillRect(from, bbox.top, Math.max(to - from, devicePixelRatio), bbox.height);
    }
    ctx.restore();
  };

  const explain = (plan, legend) => {
    if (!plan.left_out?.length || plan.curves.length < 2) return;
    const item = document.createElement("span"), swatch = document.createElement("i");
    swatch.className = "shade";
    item.append(swatch, "left out");
    legend.append(item);
  };

  const build = plan => {
    const room = document.getElementById(plan.name);
    const { data, drawn, bands } = assemble(plan);
    const decades = plan.curves[0].kind === "decades";
    const legend = room.parentElement.querySelector(".legend"), values = key(plan, legend);
    explain(plan, legend);
    const axis = { stroke: () => colour("muted"), font: "12px system-ui, sans-serif", ticks: { show: false },
      grid: { stroke: () => colour("grid"), width: 1 } };
    const chart = new uPlot({
      width: room.clientWidth, height: plan.height, legend: { show: false }, padding: [8, 28, 0, 0],
      scales: { x: { time: false, auto: false, range: () => shown }, y: { range: fitted(plan) } },
      axes: [
        { ...axis, size: 26, gap: 4, space: 70, values: (_, ticks) => ticks.map(t => plain(t, 9) + " s") },
        { ...axis, size: 66, gap: 6, space: 26, incrs: decades ? [0.1, 0.2, 0.5, 1, 2, 3, 4, 5, 10] : undefined,
          values: (_, ticks) => ticks.map(v => (decades ? decade(v) : plain(v, 6))) },
      ],
      series: drawn, bands,
      cursor: {
        y: false, points: { show: false }, drag: { x: true, y: false, dist: 6 },
        bind: { dblclick: () => () => { actions.all(); return null; } },
        sync: { key: "time", scales: ["x", null], filters: { pub: type => type !== "mousedown" && type !== "mouseup" } },
      },
      hooks: {
        drawClear: plan.left_out ? [shade(plan)] : [],
        setSelect: [chart => {
          const { left, width } = chart.select;
          if (width > 0) show(chart.posToVal(left, "x"), chart.posToVal(left + width, "x"));
          chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
        setCursor: [chart => {
          const at = chart.cursor.idx;
          values.forEach((place, i) => {
            const curve = plan.curves[i], value = at == null || curve.kind === "band" ? null : chart.data[i + 1 + later(plan, i)][at];
            place.textContent = value == null ? "" : decades ? plain(10 ** value, 3) : plain(value, 5);
          });
        }],
      },
    }, data, room);
    chart.cursor.drag.setScale = false;
    room.addEventListener("keydown", event => {
      if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
      event.preventDefault();
      actions[keys[event.key]]();
    });
    room.addEventListener("wheel", event => {
      if (!event.ctrlKey) return;
      event.preventDefault();
      actions[event.deltaY < 0 ? "in" : "out"]();
    }, { passive: false });
    new ResizeObserver(() => {
      if (room.clientWidth && room.clientWidth !== chart.width) chart.setSize({ width: room.clientWidth, height: plan.height });
    }).observe(room);
    return chart;
  };
  // a band takes two rows of data where its curve has one entry
  const later = (plan, i) => plan.curves.slice(0, i).filter(curve => curve.kind === "band").length;

  try {
    for (const plan of plans) made.push(build(plan));
  } catch (error) { // the static pictures take their place
    document.documentElement.classList.remove("script");
    throw error;
  }
  actions.all();
  for (const button of document.querySelectorAll("[data-do]")) button.addEventListener("click", () => actions[button.dataset.do]());
  addEventListener("beforeprint", () => document.querySelectorAll(".fold").forEach(fold => { fold.open = true; }));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => made.forEach(chart => chart.redraw(false, true)));
  window.replantCharts = made;
})();
