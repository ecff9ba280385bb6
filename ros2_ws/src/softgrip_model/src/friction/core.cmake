# SPDX-License-Identifier: Apache-2.0
softgrip_core(friction src/friction/binding.cpp src/friction/fit.cpp)
