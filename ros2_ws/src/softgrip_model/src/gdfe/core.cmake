# SPDX-License-Identifier: Apache-2.0
find_library(HWY_LIBRARY hwy)
find_path(HWY_INCLUDE_DIR hwy/highway.h)
if(NOT HWY_LIBRARY OR NOT HWY_INCLUDE_DIR)
  message(FATAL_ERROR "softgrip_model needs Highway, SIMD with dispatch at run time. Type: sudo apt-get install libhwy-dev")
endif()
softgrip_core(gdfe src/gdfe/aggregation.cpp src/gdfe/anderson.cpp src/gdfe/anderson_passes.cpp src/gdfe/assembly.cpp src/gdfe/binding.cpp
  src/gdfe/blocked_rows.cpp src/gdfe/cable.cpp src/gdfe/contact.cpp src/gdfe/element_blocks.cpp src/gdfe/factor.cpp
  src/gdfe/follower.cpp src/gdfe/inverted.cpp src/gdfe/local_step.cpp src/gdfe/mesh.cpp src/gdfe/multigrid.cpp
  src/gdfe/multigrid_cycle.cpp src/gdfe/node_rows.cpp src/gdfe/ogden.cpp src/gdfe/ordering.cpp src/gdfe/panel_factor.cpp
  src/gdfe/panel_solve.cpp src/gdfe/sections.cpp src/gdfe/simd.cpp src/gdfe/solver.cpp src/gdfe/solver_cables.cpp
  src/gdfe/solver_sections.cpp src/gdfe/solver_setup.cpp src/gdfe/stream.cpp)
target_include_directories(gdfe_core PRIVATE ${CMAKE_CURRENT_SOURCE_DIR} ${HWY_INCLUDE_DIR})
target_link_libraries(gdfe_core PRIVATE ${HWY_LIBRARY})

# Vectors are kept in arrays: not possible with the sizeless types of SVE and RVV, which run NEON or scalar code.
target_compile_definitions(gdfe_core PRIVATE
  "HWY_DISABLED_TARGETS=(HWY_SVE|HWY_SVE2|HWY_SVE_256|HWY_SVE2_128|HWY_RVV)")

# Eigen's own threads would keep every processor busy in the set-up, whatever Settings.threads says.
target_compile_definitions(gdfe_core PRIVATE EIGEN_DONT_PARALLELIZE)

find_package(OpenMP COMPONENTS CXX)
if(OpenMP_CXX_FOUND)
  target_link_libraries(gdfe_core PRIVATE OpenMP::OpenMP_CXX)
else()
  message(STATUS "OpenMP not found: the GDFE core runs on one thread")
endif()

# Ordering of large matrices; without it AMD orders them all: larger factors above some 5,000 hexahedra.
find_library(METIS_LIBRARY metis)
find_path(METIS_INCLUDE_DIR metis.h)
if(METIS_LIBRARY AND METIS_INCLUDE_DIR)
  target_compile_definitions(gdfe_core PRIVATE SOFTGRIP_HAVE_METIS)
  target_include_directories(gdfe_core PRIVATE ${METIS_INCLUDE_DIR})
  target_link_libraries(gdfe_core PRIVATE ${METIS_LIBRARY})
else()
  message(STATUS "METIS not found (apt-get install libmetis-dev): large GDFE meshes are ordered by AMD")
endif()
