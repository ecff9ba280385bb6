softgrip_core(finger src/finger/binding.cpp)
