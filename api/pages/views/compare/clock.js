/** One clock for several videos, which play, stop and seek together. The longest one leads. */

import { useEffect, useRef, useState } from "../../lib/html.js";

const LOOK_MS = 100;
const MOST_DRIFT_S = 0.25; // Beyond it a video jumps; below it, it plays a little faster or slower.

/**
 * @param {{current: HTMLElement}} box Holds the videos, which do not loop.
 * @param {number} speed Seconds of video a second.
 * @param {string} key Changes when another video is shown.
 * @returns time, duration: seconds, of the longest; isPlaying, setPlaying; scrub: stops at a time;
 *   settle: to be called once a video has loaded, or cannot. A video that ends before the longest holds its last picture.
 */
export function useClock(box, speed, key) {
  const now = useRef(0);
  const rate = useRef();
  rate.current = speed;
  const [time, setTime] = useState(0);
  const [duration, setDuration] = useState(0);
  const [isPlaying, setPlaying] = useState(false);

  const all = () => [...(box.current?.querySelectorAll("video") || [])];
  const loaded = () => all().filter((video) => video.readyState > 0);
  const isLoading = () => all().some((video) => !video.readyState && !video.error);
  const longest = () => loaded().reduce((most, video) => (most?.duration >= video.duration ? most : video), null);

  const seek = (next) => {
    now.current = Math.min(Math.max(next, 0), longest()?.duration || 0);
    for (const video of loaded()) {
      const goal = Math.min(now.current, video.duration);
      if (goal || video.currentTime) video.currentTime = goal; // At the beginning its poster stays.
    }
    setTime(now.current);
  };
  const settle = () => {
    if (isLoading()) return;
    setDuration(longest()?.duration || 0);
    seek(now.current);
  };
  useEffect(settle, [key]);

  useEffect(() => {
    if (!isPlaying) return undefined;
    const pause = () => loaded().forEach((video) => video.pause());
    const follow = () => {
      const leader = longest();
      if (!leader || isLoading()) return pause();
      if (leader.ended) seek(0);
      else setTime((now.current = leader.currentTime));
      for (const video of loaded()) keep(video, video === leader ? 0 : now.current - video.currentTime, rate.current);
    };
    follow();
    const timer = setInterval(follow, LOOK_MS);
    return () => {
      clearInterval(timer);
      pause();
      seek(now.current);
    };
  }, [isPlaying]);

  const scrub = (next) => {
    now.current = next;
    setPlaying(false);
    seek(next);
  };
  return { time, duration, isPlaying, setPlaying, scrub, settle };
}

/** Let a video play on, behind: how many seconds it is later than the leader. */
function keep(video, behind, speed) {
  if (video.ended || video.seeking) return;
  const isFar = Math.abs(behind) > MOST_DRIFT_S;
  if (isFar) video.currentTime += behind;
  video.playbackRate = speed * (isFar ? 1 : 1 + behind);
  if (video.paused) video.play().catch(() => {}); // It was stopped or taken away meanwhile.
}
