// The models: what is asked for, and a card for each.
import { act, at, check, element, fill, keep, kept, keyed, log, state, write } from "./page.js";
import { ROLES } from "./curves.js";
import { drawSign } from "/assets/served.js";
import { typeset } from "/assets/model.js";
import { count, number, percent, share } from "/assets/format.js";

const KIND_WORDS = { fit: "Fit", search: "Search", run: "Run online" };
const HINTS = {
  fit: "A number, or a range such as 1:3, which makes a model of each",
  search: "Ranges such as 1:4: the structure with the most evidence wins",
  run: "One pass, sample by sample, as live",
};
const SVG = "http://www.w3.org/2000/svg";
const told = new Map();
let look = () => {}, refused = null; // the log whose fields hold what the server has not accepted, and that

/** Have a function called with the place in the plots that a reason speaks of. */
export const whenLooked = call => { look = call; };

// --- what is asked for ---
const wish = () => ({ kind: document.querySelector("[name=kind]:checked")?.value ?? "fit", poles: at("poles").value, zeros: at("zeros").value, delay: at("delay").value });

at("wish").addEventListener("submit", async event => {
  event.preventDefault();
  const opened = log();
  if (!opened) return;
  const found = await wished("fit");
  if (found) choose(found.made[0]);
});
at("wish").addEventListener("change", () => log() && wished("wish"));

/** Send what is typed.  What the server refuses stays in its fields, to be corrected. */
async function wished(action) {
  const asked = refused = { log: log().name, wish: wish() };
  const found = await act(action, asked);
  if (found && refused === asked) refused = null; // nothing newer is on its way
  if (found) drawWish();
  return found;
}

export function drawWish() {
  const opened = log();
  if (refused?.log !== opened?.name) refused = null; // another log fills the fields
  if (!opened) return;
  if (!refused) {
    check(document.querySelector(`[name=kind][value=${opened.wish.kind}]`), true);
    for (const name of ["poles", "zeros", "delay"]) fill(at(name), opened.wish[name]);
  }
  const chosen = document.querySelector("[name=kind]:checked").value;
  at("zeros").placeholder = chosen === "search" ? "all" : "0";
  write(at("fit"), KIND_WORDS[chosen]);
  write(at("hint"), HINTS[chosen]);
  at("fit").disabled = !opened.setup.input || !opened.setup.output;
}

// --- cards ---
export const chosen = () => kept().get("model") ?? state.session?.cards.at(-1)?.name ?? "";
export function choose(name) {
  keep({ model: name });
  drawCards();
}

const fitOf = card => (card.unseen?.length ? Math.min(...card.unseen.map(each => each.fit ?? -Infinity)) : card.fit);

/** A reason, as a button that shows in the plots what it speaks of. */
export function reasonOf(reason, card, part) {
  const text = reason.text[0].toUpperCase() + reason.text.slice(1);
  return element("li", {}, element("button", { type: "button", class: "reason", title: "Show it in the plots", onclick: () => look(reason, card, part) }, text));
}

function makeCard() {
  const sign = document.createElementNS(SVG, "svg");
  sign.setAttribute("class", "sign");
  sign.setAttribute("viewBox", "0 0 24 24");
  sign.setAttribute("aria-hidden", "true");
  const card = element("li", { class: "card" },
    element("div", { class: "head" },
      element("label", { class: "tick" }, element("input", { type: "checkbox" }), element("i", { class: "tint", "aria-hidden": "true" }), element("span", { class: "unseen" }, "")),
      element("button", { type: "button", class: "title" }), element("input", { class: "renamed", hidden: true, "aria-label": "Name of the model", maxlength: "200" }), element("b", { class: "best" })),
    element("div", { class: "progress", hidden: true }, element("progress", { max: "100" }), element("span", {}), element("button", { type: "button", class: "small stop" }, "Stop")),
    element("p", { class: "failed", hidden: true }),
    element("div", { class: "result", hidden: true },
      element("p", { class: "judged" }, sign, element("span", {})),
      element("div", { class: "formula", tabindex: "0", role: "region", "aria-label": "Transfer function" }),
      element("p", { class: "figures aside" }),
      element("ul", { class: "unseen-on" }),
      element("details", { class: "why" }, element("summary", {}, "Reasons"), element("ul", { class: "reasons" }), element("table", { class: "candidates", hidden: true }))),
    element("div", { class: "tools" }, element("button", { type: "button", class: "small again", hidden: true }, "Fit again"),
      element("button", { type: "button", class: "small rename" }, "Rename"), element("button", { type: "button", class: "small remove" }, "Remove")));
  const named = () => card.dataset.key, field = card.querySelector(".renamed");
  card.querySelector("[type=checkbox]").addEventListener("change", event => act("show", { card: named(), chosen: event.target.checked }));
  card.querySelector(".title").addEventListener("click", () => choose(named()));
  card.querySelector(".stop").addEventListener("click", () => act("stop", { card: named() }));
  card.querySelector(".again").addEventListener("click", () => act("repeat", { card: named() }));
  card.querySelector(".remove").addEventListener("click", () => act("remove", { card: named() }));
  card.querySelector(".rename").addEventListener("click", () => {
    field.value = state.session.cards.find(each => each.name === named()).given;
    field.hidden = false;
    card.querySelector(".title").hidden = true;
    field.select();
    field.focus();
  });
  const done = save => {
    if (field.hidden) return;
    field.hidden = true;
    card.querySelector(".title").hidden = false;
    if (save && field.value.trim()) act("rename", { card: named(), title: field.value });
  };
  field.addEventListener("blur", () => done(true));
  field.addEventListener("keydown", event => {
    if (event.key !== "Enter" && event.key !== "Escape") return;
    event.preventDefault();
    done(event.key === "Enter");
    card.querySelector(".rename").focus();
  });
  return card;
}

function updateCard(room, card) {
  check(room.querySelector("[type=checkbox]"), state.session.shown.includes(card.name));
  const now = JSON.stringify([card, state.session.shown, chosen()]);
  if (told.get(room) === now) return;
  told.set(room, now);
  const place = state.session.shown.indexOf(card.name), done = card.state === "done", runs = card.state === "running" || card.state === "waiting", one = name => room.querySelector(name);
  room.dataset.state = card.state;
  room.setAttribute("aria-current", String(chosen() === card.name));
  write(one(".title"), card.title);
  write(one(".tick .unseen"), `Compare ${card.title}`);
  one("[type=checkbox]").disabled = !done;
  one(".tint").style.background = place >= 0 ? `var(--${ROLES[place]})` : "";
  const fit = done ? fitOf(card) : null;
  write(one(".best"), done ? percent(fit) : "");
  one(".best").title = card.unseen?.length ? "Fit on what it has not seen" : "Fit to the samples that it was made from";
  one(".progress").hidden = !runs;
  one("progress").value = card.percent;
  write(one(".progress span"), card.state === "waiting" ? "waits for its turn" : `${card.stage} ${card.percent} %`);
  one(".failed").hidden = !["failed", "stopped"].includes(card.state);
  write(one(".failed"), card.state === "stopped" ? "Stopped." : card.error);
  one(".again").hidden = !["failed", "stopped"].includes(card.state);
  one(".result").hidden = !done;
  if (done) drawResult(one, card);
}

/** The gravest verdict of a card, and on which stretch it is; of two as grave that on what the model has not seen. */
function gravestOf(card) {
  const grave = verdict => ["good", "warn", "bad"].indexOf(verdict.gravity);
  return [...card.unseen.map(each => [each.on, each.verdict]), ["", card.verdict]].reduce((one, other) => (grave(other[1]) > grave(one[1]) ? other : one));
}

function drawResult(one, card) {
  const { reasons } = card.verdict, [on, gravest] = gravestOf(card);
  one(".judged").dataset.gravity = gravest.gravity;
  drawSign(one(".sign"), gravest.gravity);
  write(one(".judged span"), `${gravest.headline}${on ? ` on ${on}` : ""}: ${gravest.reasons[0]?.text ?? ""}`);
  typeset(one(".formula"), card);
  const known = card.known === null || card.known >= 1 ? "a coefficient is not known" : `coefficients within ± ${share(card.known)}`;
  write(one(".figures"), `${percent(card.fit)} on the ${count(card.samples)} samples it was made from; ${known}`);
  one(".unseen-on").replaceChildren(...card.unseen.map(each => element("li", {}, element("span", { class: "on" }, `Unseen, ${each.on}: ${percent(each.fit)},`), " ",
    element("span", { class: "word", "data-gravity": each.verdict.gravity }, each.verdict.headline))));
  const heard = card.unseen.flatMap((each, i) => each.verdict.reasons.map(reason => [reason, i])), all = reasons.length + heard.length;
  write(one("summary"), `${all === 1 ? "The reason" : `${all} reasons`}${card.candidates.length ? ` · ${card.tried} structures tried` : ""}`);
  one(".why > .reasons").replaceChildren(...reasons.map(reason => reasonOf(reason, card, null)),
    ...heard.map(([reason, i]) => reasonOf({ ...reason, text: `On ${card.unseen[i].on}: ${reason.text}` }, card, i)));
  const table = one(".candidates");
  table.hidden = !card.candidates.length;
  table.replaceChildren(element("thead", {}, element("tr", {}, ...["Poles", "Zeros", "Dead time", "Fit", "Evidence"].map(each => element("th", { scope: "col" }, each)), element("th", {}, element("span", { class: "unseen" }, "Fit it")))),
    element("tbody", {}, ...card.candidates.map(each => element("tr", each.chosen ? { class: "best-row" } : {}, ...[each.poles, each.zeros, `${number(each.delay, 3)} s`, percent(each.fit), each.behind ? `−${each.behind.toFixed(1)}` : "most"].map(cell => element("td", {}, String(cell))),
      element("td", {}, element("button", { type: "button", class: "small", "aria-label": `Fit ${each.poles} poles, ${each.zeros} zeros, ${each.delay} s`, onclick: () => act("fit", { log: card.log, wish: { kind: "fit", poles: String(each.poles), zeros: String(each.zeros), delay: String(each.delay) } }) }, "Fit"))))));
}

export function drawCards() {
  const { cards, order } = state.session;
  keyed(at("cards"), cards, card => card.name, makeCard, updateCard);
  const running = cards.filter(card => card.state === "running" || card.state === "waiting").length;
  write(at("count"), cards.length ? `${cards.length} model${cards.length === 1 ? "" : "s"}${running ? `, ${running} being made` : ""}` : "No models yet");
  fill(at("order"), order);
  const last = cards.filter(card => card.state === "done").at(-1);
  write(at("announced"), last ? `${last.title}: fit ${percent(fitOf(last))}, ${gravestOf(last)[1].headline}` : "");
}

at("order").addEventListener("change", () => act("sort", { order: at("order").value }));
