/** Metrics in sections, the important ones first; which of them a reader pinned or opened is kept by the browser. */

import { useState } from "./html.js";

// As people look at a training: does it earn more, is it fast, does it stay up, how long does it take?
const FIRST = [
  "eval/episode_reward",
  "training/episode_reward",
  "eval/forward_speed",
  "training/forward_speed",
  "eval/avg_episode_length",
  "training/episode_length",
  "training/fall_rate",
  "training/sps",
];
const LOSS = /^training\/(.*_)?loss$/;
const TERM = /^(eval\/episode_|training\/)(reward|cost)_/;
// States of the body, whose sums over the steps of an episode are neither metres nor metres per second.
const SUMMED = /^eval\/episode_.*(position|velocity|distance|height|speed)/;

const isFirst = (name) => FIRST.includes(name) || LOSS.test(name);
const SECTIONS = [
  ["Important", isFirst],
  ["Reward by term", (name) => TERM.test(name) && !name.endsWith("_std")],
  ["Evaluation", (name) => name.startsWith("eval/") && !SUMMED.test(name)],
  ["Training", (name) => name.startsWith("training/")],
  ["Sums over an episode's steps", (name) => SUMMED.test(name)],
  ["Others", () => true],
];

/** Sections that are open until somebody closes them. */
export const OPEN = ["Pinned", "Important"];
export const HINTS = {
  "Sums over an episode's steps": "Of each step the environment reports a position, speed or distance; these are their sums. Divided by the episode's length they are means.",
};

/**
 * @param {string[]} names @param {string[]} pinned Shown before everything else, in this order.
 * @returns {[string, string[]][]} Sections that have metrics.
 */
export function sectionsOf(names, pinned) {
  const found = new Map([["Pinned", pinned.filter((name) => names.includes(name))], ...SECTIONS.map(([title]) => [title, []])]);
  const rank = (name) => (FIRST.includes(name) ? FIRST.indexOf(name) : FIRST.length);
  for (const name of [...names].sort((a, b) => rank(a) - rank(b) || (a < b ? -1 : 1))) {
    if (!pinned.includes(name)) found.get(SECTIONS.find(([, has]) => has(name))[0]).push(name);
  }
  return [...found].filter(([, inside]) => inside.length);
}

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
