// What the pages that are served have in common: elements, notices, requests, menus, and the connection to the server.
import { readColours } from "./chart.js";
import { SIGNS } from "./words.js";

export const at = id => document.getElementById(id);
export const write = (place, text) => { if (place.textContent !== text) place.textContent = text; };

/** An element with attributes, properties of `on...` and children; texts stay texts. */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

/** Draw the sign of a gravity, whose shape tells it without its colour, into an svg of 24 by 24. */
export const drawSign = (svg, gravity) => { svg.innerHTML = SIGNS[gravity]; };

export function say(text) {
  at("notice").hidden = !text;
  write(at("notice"), text);
}

/** Fetch something; null where this failed, which is said: `lost` where there is no server. */
export async function answered(path, options, lost) {
  try {
    const answer = await fetch(path, options);
    if (answer.ok) return answer;
    say((await answer.text()).trim() || `The server answered ${answer.status}.`);
  } catch (error) {
    if (error.name !== "AbortError") say(lost);
  }
  return null;
}

export function download(blob, name) {
  const url = URL.createObjectURL(blob);
  element("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

/** A menu folds after a choice, after a click elsewhere, and on Escape. */
export function foldable(menu) {
  document.addEventListener("click", event => { if (!menu.contains(event.target) || event.target.closest("li")) menu.open = false; });
  menu.addEventListener("keydown", event => {
    if (event.key !== "Escape" || !menu.open) return;
    menu.open = false;
    menu.querySelector("summary").focus();
  });
}

/** The token has become a cookie: the address need not show it. */
export function forgetToken() {
  if (new URLSearchParams(location.search).has("token")) history.replaceState(null, "", location.pathname + location.hash);
}

/** Repaint after a change from light to dark. */
export function whenDark(repaint) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readColours(); repaint(); });
}

const FIRST = 250; // ms, pause before connecting again; the next ones are longer

/** A websocket: told(message) of what came; closed(code) says whether to connect again, after a pause of at most `longest` ms. */
export function connection(longest, told, closed) {
  let socket = null, wait = FIRST, timer = 0;
  const connect = () => {
    clearTimeout(timer);
    socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.onmessage = event => { wait = FIRST; told(JSON.parse(event.data)); };
    socket.onclose = event => {
      if (!closed(event.code)) return;
      timer = setTimeout(connect, wait * (0.75 + Math.random() / 2));
      wait = Math.min(2 * wait, longest);
    };
  };
  connect();
  return {
    /** Connect at once, without the rest of a pause. */
    again() {
      if (socket.readyState !== WebSocket.CLOSED) return;
      wait = FIRST;
      connect();
    },
  };
}
