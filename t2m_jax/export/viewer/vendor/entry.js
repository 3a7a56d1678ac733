// What the viewer uses of three.js.
export {
  Bone, BufferAttribute, BufferGeometry, Color, DirectionalLight, DynamicDrawUsage, HemisphereLight, InstancedMesh,
  Matrix4, Mesh, MeshBasicMaterial, MeshStandardMaterial, PerspectiveCamera, PlaneGeometry, Quaternion, RingGeometry,
  REVISION, Scene, ShaderMaterial, ShadowMaterial, Skeleton, SkinnedMesh, Vector3, WebGLRenderer,
} from "three";
