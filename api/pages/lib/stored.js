/** What a reader chose, kept by the browser. */

import { useState } from "./html.js";

/** A list of words under a name: the list, and a function that adds a word or takes it away. */
export function useStoredList(name, initial = []) {
  const [list, setList] = useState(() => read(name) ?? initial);
  const toggle = (word) => {
    const now = read(name) ?? list; // Another tab may have changed it.
    const next = now.includes(word) ? now.filter((one) => one !== word) : [...now, word];
    localStorage.setItem(name, JSON.stringify(next));
    setList(next);
  };
  return [list, toggle];
}

function read(name) {
  try {
    const found = JSON.parse(localStorage.getItem(name));
    return Array.isArray(found) ? found : null;
  } catch {
    return null;
  }
}
