/** Whether the service answers; every request and stream reports here, and the banner listens. */

import { useEffect, useState } from "./html.js";

const listeners = new Set();
let away = false;

/** @param {boolean} answered Whether the service gave any answer at all. */
export function report(answered) {
  if (away === !answered) return;
  away = !answered;
  for (const listener of listeners) listener(away);
}

/** True while the service does not answer. */
export function useAway() {
  const [value, setValue] = useState(away);
  useEffect(() => {
    listeners.add(setValue);
    return () => listeners.delete(setValue);
  }, []);
  return value;
}
