// A block of 0.1 x 0.1 x 0.05 m about the origin: 3 x 3 x 2 bricks of six tetrahedra.
// block.msh is made by:  gmsh -3 -format msh41 block.geo
Point(1) = {-0.05, -0.05, -0.025};
Extrude {0.1, 0, 0} { Point{1}; Layers{3}; }
out[] = Extrude {0, 0.1, 0} { Curve{1}; Layers{3}; };
body[] = Extrude {0, 0, 0.05} { Surface{out[1]}; Layers{2}; };
Physical Volume("body") = {body[1]};
Physical Surface("under") = {out[1]};
