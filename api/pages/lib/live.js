/** Documents that are asked for again and again while somebody looks. */

import { useCallback, useEffect, useRef, useState } from "./html.js";

/** Whether somebody can see the page. */
export function useVisible() {
  const [isVisible, setVisible] = useState(!document.hidden);
  useEffect(() => {
    const listener = () => setVisible(!document.hidden);
    document.addEventListener("visibilitychange", listener);
    return () => document.removeEventListener("visibilitychange", listener);
  }, []);
  return isVisible;
}

const HIDDEN = 8; // A page that nobody sees asks this many times less often.

/**
 * What `load` returns, and again every `every` ms (never if 0 or if `every` returns 0).
 * @param {(signal: AbortSignal, isRepeated: boolean) => Promise<any>} load
 * @param {any[]} inputs `load` runs at once when one of them changes.
 * @returns {{data: any, error: Error | null, again: () => void}} The last data stay while an error lasts.
 */
export function useLive(load, inputs, every = 0) {
  const [state, setState] = useState({ data: null, error: null });
  const runs = useRef({});
  runs.current.load = load;
  runs.current.every = every;
  const again = useCallback(() => runs.current.start?.(), []);
  useEffect(() => {
    setState({ data: null, error: null });
    let control;
    let timer;
    let isRepeated = false;
    const start = async () => {
      clearTimeout(timer);
      control?.abort();
      const mine = (control = new AbortController());
      let wait;
      try {
        const data = await runs.current.load(mine.signal, isRepeated);
        isRepeated = true;
        if (mine.signal.aborted) return;
        setState({ data, error: null });
        wait = typeof runs.current.every === "function" ? runs.current.every(data) : runs.current.every;
      } catch (error) {
        if (mine.signal.aborted) return;
        setState((before) => ({ ...before, error }));
        wait = error.status && error.status < 500 ? 0 : 3000; // A refusal stays; an outage passes.
      }
      if (wait) timer = setTimeout(start, document.hidden ? wait * HIDDEN : wait);
    };
    const onVisible = () => document.hidden || !timer || start();
    document.addEventListener("visibilitychange", onVisible);
    runs.current.start = start;
    start();
    return () => {
      clearTimeout(timer);
      control?.abort();
      document.removeEventListener("visibilitychange", onVisible);
    };
  }, inputs);
  return { ...state, again };
}
