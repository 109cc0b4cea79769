// Stretches of time that are used, left out, or validated on: marked on the plots, listed, typed.
import { act, at, element, fill, isCurrent, keyed, log, say } from "./page.js";
import { number, tick } from "/assets/format.js";

export const KINDS = { use: ["use", "good"], leave_out: ["leave out", "bad"], validate_on: ["validate on", "accent"] };

/** Round a time that was dragged to what a pixel of the shown width can tell. */
export function nice(value, width) {
  const step = 10 ** Math.floor(Math.log10(width / 300));
  return Math.max(0, +(Math.round(value / step) * step).toPrecision(12));
}

/** The stretches of the log that is shown, as the plots shade them. */
export function shaded(setup, end) {
  return Object.entries(KINDS).flatMap(([kind, [, role]]) => setup[kind].map(([from, to]) => [from, to ?? end, role]));
}

/** Have a stretch in place of another; null: in place of none, or none in its place.  The server knows all the others. */
const change = (kind, before, after) => act("stretch", { log: log().name, kind, before, after });
export const addStretch = (kind, begin, end) => change(kind, null, [begin, end]);

/** A time as it is typed: 12.5, or 1:05; NaN where it is none. */
export function typed(text) {
  const parts = text.trim().replace(",", ".").split(":");
  return parts.length > 3 || parts.some(part => !/^\d*\.?\d+$/.test(part)) ? NaN : parts.reduce((sum, part) => 60 * sum + Number(part), 0);
}

function ends(begin, end) {
  const found = [begin.trim() ? typed(begin) : 0, end.trim() ? typed(end) : null];
  if (!(begin + end).trim() || Number.isNaN(found[0]) || Number.isNaN(found[1]) || (found[1] !== null && found[1] <= found[0])) {
    say("Write the stretch in s from the first sample, as in 12.5 to 40; without an end it goes on to the last.");
    return null;
  }
  return found;
}

at("add").addEventListener("submit", async event => {
  event.preventDefault();
  const found = log() && ends(at("add-begin").value, at("add-end").value);
  if (!found || !await addStretch(at("add-kind").value, ...found)) return;
  at("add-begin").value = at("add-end").value = "";
  at("add-begin").focus();
});

export function drawStretches(setup) {
  const items = Object.keys(KINDS).flatMap(kind => setup[kind].map((stretch, index) => ({ kind, index, stretch })));
  keyed(at("stretches"), items, item => `${item.kind} ${item.index}`, item => {
    const [name] = KINDS[item.kind], begin = element("input", { inputmode: "decimal", "aria-label": `${name} from, in s` });
    const end = element("input", { inputmode: "decimal", "aria-label": `${name} to, in s`, placeholder: "end" });
    const row = element("li", { "data-stretch": JSON.stringify(item.stretch) }), shown = () => JSON.parse(row.dataset.stretch);
    const changed = () => {
      const before = shown(), found = ends(begin.value, end.value);
      if (!found) return;
      row.dataset.stretch = JSON.stringify(found);
      change(item.kind, before, found);
    };
    begin.addEventListener("change", changed);
    end.addEventListener("change", changed);
    row.append(element("i", { class: `swatch ${item.kind}`, "aria-hidden": "true" }), element("span", { class: "kind" }, name), begin,
      element("span", { "aria-hidden": "true" }, "–"), end,
      element("button", { type: "button", class: "small", "aria-label": `Remove: ${name}, stretch ${item.index + 1}`, onclick: () => change(item.kind, shown(), null) }, "×"));
    return row;
  }, (row, { stretch: [from, to] }) => {
    if (isCurrent()) row.dataset.stretch = JSON.stringify([from, to]);
    const [begin, end] = row.querySelectorAll("input");
    fill(begin, plain(from));
    fill(end, to === null ? "" : plain(to));
  });
}

const plain = value => (Math.abs(value) < 1e-4 && value ? number(value) : tick(value).replace("−", "-"));
