// The state of the session, which lives on the server: how it comes, how the page asks and acts, and what the address keeps.
import { answered as fetched, at, connection, download, element, say, write } from "/assets/served.js";

export { at, download, element, say, write };

export const state = { session: null, open: false };
let sent = 0, known = 0; // actions that are not answered yet; revision of the session that the newest answer told, of this connection
const listeners = [];
/** Have a function called with each new state of the session. */
export const whenever = listener => listeners.push(listener);
const draw = () => { for (const listener of listeners) listener(state.session); };
/** Whether the session that is here knows all that this page has sent: before it does, it must not undo what was chosen. */
export const isCurrent = () => !sent && state.session.revision >= known;

// --- fields ---
/** Set a field, unless somebody is typing there, or what was chosen there is on its way. */
export const fill = (field, value) => { if (isCurrent() && !(document.activeElement === field && field.type === "text") && field.value !== value) field.value = value; };
/** Check a box or a circle, or not, unless what was chosen there is on its way. */
export const check = (box, checked) => { if (isCurrent()) box.checked = checked; };

/** One child of a room for each item, made once by its key and updated with each state.  What has the focus stays where it is, the others move: a field that is moved loses it, and what is typed. */
export function keyed(room, items, keyOf, make, update) {
  const known = new Map([...room.children].map(child => [child.dataset.key, child])), typed = [...room.children].find(child => child.contains(document.activeElement));
  let place = room.firstChild;
  for (const item of items) {
    const key = String(keyOf(item));
    let child = known.get(key);
    known.delete(key);
    if (!child) { child = make(item); child.dataset.key = key; }
    if (child === typed) {
      while (place !== child) {
        const next = place.nextSibling;
        room.append(place);
        place = next;
      }
    }
    if (child !== place) room.insertBefore(child, place);
    else place = place.nextSibling;
    update(child, item);
  }
  for (const child of known.values()) child.remove();
}

// --- what the address keeps, so that a reload and a second page have their own ---
export function kept() {
  return new URLSearchParams(location.hash.slice(1));
}
export function keep(changes) {
  const found = kept();
  for (const [name, value] of Object.entries(changes)) {
    if (value === null || value === "") found.delete(name);
    else found.set(name, value);
  }
  history.replaceState(null, "", `#${found}`);
}

// --- asking and acting ---
const answered = (path, options) => fetched(path, options, "The server cannot be reached: is replant open still running?");

let last = Promise.resolve();
/** Do something to the session, after what was asked before; its new state comes by itself. */
export function act(name, given = {}) {
  say("");
  sent += 1;
  const done = last.then(async () => {
    try {
      const answer = await answered(`/do/${name}`, { method: "POST", body: JSON.stringify(given) }), found = answer && await answer.json();
      known = found?.revision ?? known;
      return found;
    } finally {  // also where the server dies within its answer
      sent -= 1;
      if (state.session && !sent) draw();
    }
  });
  last = done.catch(() => null);
  return done;
}

export async function send(path, body) {
  say("");
  return answered(path, { method: "POST", body });
}

const asked = new Map();
/** Ask for something that is drawn; a newer question of the same name takes the place of an older one. */
export async function ask(name, given) {
  asked.get(name)?.abort();
  const stop = new AbortController();
  asked.set(name, stop);
  const words = new URLSearchParams(Object.entries(given).filter(([, value]) => value !== null && value !== undefined));
  const answer = await answered(`/ask/${name}?${words}`, { signal: stop.signal });
  return answer && answer.json().catch(error => { if (error.name !== "AbortError") throw error; return null; });
}

export const log = () => state.session?.logs.find(each => each.name === state.session.active) ?? null;
/** Change what was chosen for the log that is shown. */
export const choose = setup => act("setup", { log: log().name, setup });

/** Call a function a moment after the last of many calls. */
export function later(wait, call) {
  let timer = 0;
  return (...given) => { clearTimeout(timer); timer = setTimeout(() => call(...given), wait); };
}

// --- the connection ---
const LONGEST = 8_000; // ms, pause before connecting again

function showLink(stateOf, text) {
  at("link").dataset.state = stateOf;
  write(at("link").querySelector("span"), text);
}

function told(message) {
  if (!state.open) { state.open = true; known = 0; say(""); showLink("connected", "connected"); }
  if (!message.view) return;
  state.session = message.view;
  draw();
}

function closed(code) {
  state.open = false;
  if ([1000, 1001, 1012].includes(code)) {  // as it closes itself, or as the server does that stops
    showLink("ended", "ended");
    say("The workbench has ended; the session is kept. Start it again with replant open: this page then comes back.");
  } else showLink("reconnecting", "reconnecting");
  return true;
}

export const connect = () => connection(LONGEST, told, closed);
