import { tick } from "./format.js";

const { columns, rows } = JSON.parse(document.getElementById("data").textContent);
const PAGE = 100;
const at = id => document.getElementById(id);
const texts = rows.map(row => columns.map((column, k) => (column.text ? row[k] : "")).join("\n").toLowerCase());
const ranked = columns.findIndex(column => column.name === "rank");
let found = rows.map((_, k) => k), first = 0, by = 0, down = false;

const shown = value => {
  if (value === null) return "\u2013";
  return Number.isInteger(value) && Math.abs(value) < 1e9 ? value.toLocaleString("en") : tick(value, 4);
};
const compare = (a, b) => {
  const one = rows[a][by], other = rows[b][by];
  if (one === null || other === null) return (one === null) - (other === null) || a - b; // what is not known comes last
  const order = columns[by].text ? (one < other ? -1 : +(one > other)) : one - other;
  return (down ? -order : order) || a - b;
};
const find = () => {
  const words = at("search").value.toLowerCase().split(/\s+/).filter(Boolean);
  found = rows.map((_, k) => k).filter(k => words.every(word => texts[k].includes(word))).sort(compare);
  first = 0;
  draw();
};
const cell = (kind, value, column) => {
  const element = document.createElement(kind);
  element.textContent = column.text ? value : shown(value);
  if (column.text) element.className = column.long ? "long" : "text";
  element.dataset.name = column.name;
  return element;
};
const draw = () => {
  const page = found.slice(first, first + PAGE);
  at("body").replaceChildren(...page.map(k => {
    const line = document.createElement("tr"), row = rows[k];
    line.id = "rig-" + row[ranked];
    columns.forEach((column, c) => {
      const element = cell(c === 0 ? "th" : "td", row[c], column);
      if (c === 0) {
        element.scope = "row";
        if (row[columns.length]) {
          const link = document.createElement("a");
          link.href = row[columns.length];
          link.textContent = row[0];
          element.replaceChildren(link);
        }
      }
      line.append(element);
    });
    return line;
  }));
  const last = Math.min(first + PAGE, found.length);
  at("shown").textContent = found.length ? `${first + 1} to ${last} of ${found.length.toLocaleString("en")}` : "none found";
  at("back").disabled = first === 0;
  at("on").disabled = last === found.length;
  document.querySelectorAll("#head button").forEach((button, k) => {
    button.setAttribute("aria-pressed", String(k === by));
    button.parentElement.setAttribute("aria-sort", k === by ? (down ? "descending" : "ascending") : "none");
    button.textContent = columns[k].name + (k === by ? (down ? " \u2193" : " \u2191") : "");
  });
};
at("head").append(...columns.map((column, k) => {
  const head = document.createElement("th"), button = document.createElement("button");
  head.scope = "col";
  if (column.text) head.className = "text";
  button.addEventListener("click", () => {
    down = by === k ? !down : Boolean(column.down);
    by = k;
    found.sort(compare);
    first = 0;
    draw();
  });
  head.append(button);
  return head;
}));
by = ranked;
at("search").addEventListener("input", find);
at("back").addEventListener("click", () => { first -= PAGE; draw(); });
at("on").addEventListener("click", () => { first += PAGE; draw(); });
find();
// a link to a row: all rigs by rank, the page that the row is on
const follow = () => {
  const rank = +(location.hash.match(/^#rig-(\d+)$/) || [])[1];
  if (!rank) return;
  at("search").value = "";
  by = ranked;
  down = false;
  find();
  first = Math.floor(found.findIndex(k => rows[k][ranked] === rank) / PAGE) * PAGE;
  draw();
  const line = at("rig-" + rank);
  if (!line) return;
  line.className = "meant";
  line.scrollIntoView({ block: "center" });
};
addEventListener("hashchange", follow);
follow();
