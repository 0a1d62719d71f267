"""Hot loops in C++ (nanobind); each is tested against a numpy reference."""
