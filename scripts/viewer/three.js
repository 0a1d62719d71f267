// What report/page.js uses of three.js.
export {
  BufferAttribute,
  BufferGeometry,
  Color,
  DirectionalLight,
  DoubleSide,
  Group,
  HemisphereLight,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  PerspectiveCamera,
  Points,
  PointsMaterial,
  Raycaster,
  SRGBColorSpace,
  Scene,
  Sphere,
  Texture,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
export {OrbitControls} from "three/examples/jsm/controls/OrbitControls.js";
export {LineMaterial} from "three/examples/jsm/lines/LineMaterial.js";
export {LineSegments2} from "three/examples/jsm/lines/LineSegments2.js";
export {LineSegmentsGeometry} from "three/examples/jsm/lines/LineSegmentsGeometry.js";
