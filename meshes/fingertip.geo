// A fingertip of 20 mm x 20 mm: its back is flat, its face round (radius 30 mm), 9 mm thick in the middle.
// Fine where it grips: within 4 mm of the middle of its face.
// fingertip.msh is made by:  gmsh -3 -format msh41 fingertip.geo
SetFactory("OpenCASCADE");
Box(1) = {-0.010, -0.010, 0.0, 0.020, 0.020, 0.020};
Sphere(2) = {0.0, 0.0, -0.021, 0.030};
BooleanIntersection(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
back() = Surface In BoundingBox {-0.011, -0.011, -1e-4, 0.011, 0.011, 1e-4};
all() = Boundary { Volume{3}; };
face() = {};
For k In {0 : #all() - 1}
  box() = BoundingBox Surface { all(k) };
  If (box(5) > 0.0088)
    face() += all(k);
  EndIf
EndFor
Physical Volume("body") = {3};
Physical Surface("back") = back();
Physical Surface("face") = face();
Field[1] = MathEval;
Field[1].F = "0.0010 + 0.35 * 0.5 * (sqrt(x*x + y*y + (z-0.009)*(z-0.009)) - 0.004 + Fabs(sqrt(x*x + y*y + (z-0.009)*(z-0.009)) - 0.004))";
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeFromCurvature = 0;
Mesh.MeshSizeMax = 0.004;
