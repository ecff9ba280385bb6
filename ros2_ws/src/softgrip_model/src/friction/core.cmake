softgrip_core(friction src/friction/binding.cpp)
