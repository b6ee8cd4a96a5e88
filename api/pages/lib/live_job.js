/** One job as it is now: its document, kept fresh by its events. */

import { get } from "./api.js";
import { follow } from "./events.js";
import { useCallback, useEffect, useRef, useState } from "./html.js";
import { isOver, RETURNS } from "./job.js";
import { useLive } from "./live.js";
import { isOfASeed } from "./seeds.js";

const RELOAD_MS = 300; // Several files of one moment cost one request.
const withProgress = (job, news) => ({ ...job, progress: { ...job.progress, ...news } });

/**
 * @param {string} id
 * @returns job, error, isGone (it was deleted while somebody looked), again,
 *   onMetrics and onPhase: register a listener for what comes from now on; they return what unregisters it.
 */
export function useJob(id) {
  const [job, setJob] = useState(null);
  const [isGone, setGone] = useState(false);
  const [isHeard, setHeard] = useState(false);
  const metrics = useRef(new Set());
  const phases = useRef(new Set());
  const timer = useRef();
  // Of a queued job, no event says what it waits for; of an ended one, none says that it was deleted.
  const { data, error, again } = useLive(
    (signal) => get(`/jobs/${id}`, {}, { signal }),
    [id],
    (found) => (found.status === "queued" ? 3000 : isOver(found) ? 5000 : 15_000),
  );
  useEffect(() => data && setJob(data), [data]);
  useEffect(() => setGone(Boolean(job) && error?.status === 404), [error]);

  const isGoing = Boolean(job) && !isOver(job);
  useEffect(() => {
    if (!isGoing) return undefined;
    let stop = () => {};
    let isWanted = true;
    const soon = () => {
      clearTimeout(timer.current);
      timer.current = setTimeout(again, RELOAD_MS);
    };
    const hear = (kind, event, time, number) => {
      if (kind === "progress") setJob((known) => known && withProgress(known, event));
      else if (kind === "metrics") {
        const newest = Object.fromEntries(Object.entries(event.values).filter(([name]) => !isOfASeed(name)));
        setJob((known) => known && withProgress(known, { metrics: { ...known.progress.metrics, ...newest } }));
        metrics.current.forEach((listener) => listener({ ...event, time }));
      } else {
        phases.current.forEach((listener) => listener({ kind, ...event, time, number }));
        if (kind === "status" || kind === "artifact") soon();
      }
    };
    // The end of the feed as it is now. What the views load, they load after this: so they miss nothing.
    const start = async () => {
      const { next } = await get(`/jobs/${id}/metrics`, { points: 4, metric: RETURNS }).catch(() => ({ next: "" }));
      if (!isWanted) return;
      stop = follow(`/jobs/${id}/events`, next || "", hear, again);
      setHeard(true);
    };
    start();
    return () => {
      isWanted = false;
      stop();
      clearTimeout(timer.current);
    };
  }, [id, isGoing]);

  const register = (listeners) => (listener) => {
    listeners.current.add(listener);
    return () => listeners.current.delete(listener);
  };
  return { job: isGoing && !isHeard ? null : job, error, isGone, again, onMetrics: useCallback(register(metrics), []), onPhase: useCallback(register(phases), []) };
}
