// The paper's plate, 0.5 x 0.2 x 0.01 m: a 10 x 2 x 1 box of tetrahedra.
// plate.msh is made by:  gmsh -3 -format msh41 plate.geo
// The tests rest on the .msh file that is kept here; Gmsh releases number nodes differently.
cell = 0.05;
x[] = {0, 0.2, 0.3, 0.4, 0.5};
y[] = {0, 0.1, 0.2};
For j In {0:2}
  For i In {0:4}
    Point(1 + i + 5*j) = {x[i], y[j], 0};
  EndFor
EndFor
For j In {0:2}
  For i In {0:3}
    Line(100 + i + 5*j) = {1 + i + 5*j, 2 + i + 5*j};
    Transfinite Curve{100 + i + 5*j} = Round((x[i+1] - x[i]) / cell) + 1;
  EndFor
EndFor
For j In {0:1}
  For i In {0:4}
    Line(200 + i + 5*j) = {1 + i + 5*j, 6 + i + 5*j};
    Transfinite Curve{200 + i + 5*j} = 2;
  EndFor
EndFor
For j In {0:1}
  For i In {0:3}
    k = i + 5*j;
    Curve Loop(300 + k) = {100 + k, 201 + k, -(105 + k), -(200 + k)};
    Plane Surface(300 + k) = {300 + k};
    Transfinite Surface{300 + k};
    out[] = Extrude {0, 0, 0.01} { Surface{300 + k}; Layers{1}; };
    top(k) = out[0];
    body(k) = out[1];
    If (i == 0)
      root(j) = out[5];
    EndIf
  EndFor
EndFor
Physical Volume("body") = {body(0), body(1), body(2), body(3), body(5), body(6), body(7), body(8)};
Physical Surface("root") = {root(0), root(1)};
Physical Surface("middle") = {top(1), top(6)};
Physical Surface("tip_right") = {top(3)};
Physical Surface("tip_left") = {top(8)};
Physical Surface("tip") = {top(3), top(8)};
