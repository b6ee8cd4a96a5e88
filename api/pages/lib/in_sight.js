/** What a row of a long list shows, loaded while the row is in sight. */

import { useEffect, useRef, useState } from "./html.js";

const AT_ONCE = 3; // So that the list's own requests find a connection.
const PAUSE_MS = 4000;

const waiting = [];
let running = 0;

/** Run `task` when fewer than AT_ONCE others run. Returns what takes it back while it waits. */
function inTurn(task) {
  waiting.push(task);
  next();
  return () => waiting.includes(task) && waiting.splice(waiting.indexOf(task), 1);
}

function next() {
  if (running >= AT_ONCE || !waiting.length) return;
  running += 1;
  waiting.shift()().finally(() => {
    running -= 1;
    next();
  });
}

/**
 * What `load` returns: once the element is in sight, and again when `version` changes.
 * @param {() => Promise<any>} load
 * @param {string | number} version Nothing is loaded while it is 0 or empty.
 * @param {boolean} isOver Whether this version is the last one; others wait until PAUSE_MS after the one before.
 * @returns {[object, any]} A ref for the element, and what was loaded; null before.
 */
export function useInSight(load, version, isOver) {
  const place = useRef();
  const loaded = useRef({ version: null, at: 0 });
  const [isSeen, setSeen] = useState(false);
  const [data, setData] = useState(null);
  useEffect(() => {
    const observer = new IntersectionObserver((entries) => setSeen(entries.at(-1).isIntersecting));
    observer.observe(place.current);
    return () => observer.disconnect();
  }, []);
  useEffect(() => {
    if (!isSeen || !version || version === loaded.current.version) return undefined;
    let takeBack = () => {};
    const task = () => {
      loaded.current = { version, at: Date.now() };
      return load().then(setData, () => (loaded.current.version = null));
    };
    const wait = isOver ? 0 : Math.max(0, loaded.current.at + PAUSE_MS - Date.now());
    const timer = setTimeout(() => (takeBack = inTurn(task)), wait);
    return () => {
      clearTimeout(timer);
      takeBack();
    };
  }, [isSeen, version, isOver]);
  return [place, data];
}

/** A ref for links in a row that is wider than a phone's window: the present one is brought into sight. */
export function useCurrentInSight(...inputs) {
  const row = useRef();
  useEffect(() => {
    const current = row.current?.querySelector("[aria-current]");
    if (current) row.current.scrollLeft = current.offsetLeft - row.current.offsetLeft - (row.current.clientWidth - current.offsetWidth) / 2;
  }, inputs);
  return row;
}
