/** Light or dark: the system's choice, unless the reader made one. Canvases need the colours as numbers. */

import { useEffect, useState } from "./html.js";

const KEY = "gaitway-theme";
const system = matchMedia("(prefers-color-scheme: dark)");
const listeners = new Set();

function chosen() {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null; // A report that the service shows has no storage.
  }
}
export const isDark = () => (chosen() ? chosen() === "dark" : system.matches);

export function applyTheme() {
  document.documentElement.style.colorScheme = chosen() || "";
  for (const listener of listeners) listener(isDark());
}

export function toggleTheme() {
  localStorage.setItem(KEY, isDark() ? "light" : "dark");
  applyTheme();
}

/** Call a listener with whether the page is dark, at each change. */
export const onTheme = (listener) => listeners.add(listener);

/** Whether the page is dark now. */
export function useDark() {
  const [dark, setDark] = useState(isDark);
  useEffect(() => {
    listeners.add(setDark);
    return () => listeners.delete(setDark);
  }, []);
  return dark;
}

/** A custom property's colour as canvases understand it. */
export function colour(name) {
  const probe = document.createElement("span");
  probe.style.color = `var(${name})`;
  document.body.append(probe);
  const found = getComputedStyle(probe).color;
  probe.remove();
  return found;
}

system.addEventListener("change", applyTheme);
