softgrip_core(gdfe src/gdfe/binding.cpp)
