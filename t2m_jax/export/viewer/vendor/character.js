// What the studio uses of three.js: the viewer's part, and what draws characters of GLB files.
export * from "./entry.js";
export { AnimationMixer, Group, LoadingManager, LoopOnce } from "three";
export { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
