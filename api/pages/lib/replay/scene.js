/** The body and its surroundings from binary glTF, in materials that look as in MuJoCo's videos. */

import { MeshPhongMaterial, NoColorSpace, TextureLoader } from "../../vendor/three.js";
import { GLTFLoader } from "../../vendor/three-gltf-loader.js";

/** The scene's root. bytes: ArrayBuffer. Raises Error if they are no glTF. */
export async function readScene(bytes) {
  const loader = new GLTFLoader();
  // The default loader fetches pictures from memory, which the Content-Security-Policy takes for another host.
  loader.register((parser) => {
    parser.textureLoader = new TextureLoader(parser.options.manager);
    return { name: "pictures" };
  });
  const { scene } = await loader.parseAsync(bytes, "");
  scene.traverse((node) => {
    if (!node.isMesh) return;
    node.material = plain(node.material);
    node.castShadow = !node.userData.endless && !node.material.transparent;
    node.receiveShadow = !node.material.transparent;
    if (node.isSkinnedMesh) node.frustumCulled = false; // Its bounds are those of its rest.
  });
  return scene;
}

const known = new WeakMap();

/** MuJoCo computes light with the colours as they are on the screen; so do we (`ColorManagement` is off). */
function plain(material) {
  if (!known.has(material)) {
    const { map, transparent, opacity } = material;
    if (map) {
      map.colorSpace = NoColorSpace;
      map.anisotropy = 8;
    }
    const colour = material.color.clone().convertLinearToSRGB();
    const look = { color: colour, map, transparent, opacity, specular: 0x0c0c0c, shininess: 20, depthWrite: !transparent };
    known.set(material, new MeshPhongMaterial(look));
  }
  return known.get(material);
}
