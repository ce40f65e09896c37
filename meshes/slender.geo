// A beam of 0.5 x 0.02 x 0.02 m about the origin: 20 x 1 x 1 bricks of six tetrahedra.
// slender.msh is made by:  gmsh -3 -format msh41 slender.geo
Point(1) = {-0.25, -0.01, -0.01};
Extrude {0.5, 0, 0} { Point{1}; Layers{20}; }
out[] = Extrude {0, 0.02, 0} { Curve{1}; Layers{1}; };
body[] = Extrude {0, 0, 0.02} { Surface{out[1]}; Layers{1}; };
Physical Volume("body") = {body[1]};
Physical Surface("skin") = {out[1], body[0], body[2], body[3], body[4], body[5]};
Physical Surface("end") = {body[3]};
