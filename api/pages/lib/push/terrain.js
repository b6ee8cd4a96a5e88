/** The grounds of `simulation.json`'s `terrain` (docs/push.md), on one of which a body is. */

/** The number of the layout on which the page begins: the middle level of the first kind that is not flat. */
export function firstLayout({ layouts }) {
  const { kind } = layouts.find((one) => one.kind !== "flat") || layouts[0];
  const levels = layouts.filter((one) => one.kind === kind);
  return layouts.indexOf(levels[(levels.length - 1) >> 1]);
}

/** What a replay's header says of parts that are elsewhere in an episode: those of this layout. */
export function partsOf({ nodes, layouts }, number) {
  const { geom_pos: positions, geom_size: sizes, geom_quat: turns } = layouts[number].model;
  return nodes.map((node, box) => {
    const [w, x, y, z] = turns.slice(4 * box, 4 * box + 4);
    const [translation, scale] = [positions, sizes].map((rows) => rows.slice(3 * box, 3 * box + 3));
    return { node: `geom_${node}`, translation, scale, rotation: [x, y, z, w] };
  });
}
