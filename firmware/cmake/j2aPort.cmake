# What a port's port.mk says to the Makefile, said to a target of CMake: one place for both.
# In: port.mk, lines of NAME := value, with ?= or = as well; values may hold $(NAME). CC, CFLAGS, SIZE and SUFFIX
# are for CMake itself to choose. Out: flags of compiler and linker, further sources, the sizes of the buffers,
# and the step that finishes the image.
# Rules: what is not understood is an error, for a flag that is missing shows late, on the chip.

# Replaces $(NAME) in the variable whose name is given; port.mk's are those that begin with mk_.
macro(_j2a_expand variable)
  while("${${variable}}" MATCHES "\\$\\(([^()]*)\\)")
    set(_j2a_name "${CMAKE_MATCH_1}")
    if(_j2a_name STREQUAL "PYTHON" AND NOT DEFINED mk_PYTHON)
      find_package(Python3 REQUIRED COMPONENTS Interpreter)
      set(mk_PYTHON "\"${Python3_EXECUTABLE}\"")
    endif()
    if(NOT DEFINED mk_${_j2a_name})
      message(FATAL_ERROR "${file}: CMake does not know $(${_j2a_name}). Give j2a_add_app() SET "
                          "${_j2a_name}=value, or have no port.mk and give flags and sources to the target")
    endif()
    string(REPLACE "$(${_j2a_name})" "${mk_${_j2a_name}}" ${variable} "${${variable}}")
  endwhile()
endmacro()

# _j2a_use_port_mk(TARGET FOLDER NAME=value ...): the values win over those of the file, as make's do.
function(_j2a_use_port_mk target port)
  set(file "${port}/port.mk")
  file(READ "${file}" text)
  string(REGEX REPLACE "#[^\n]*" "" text "${text}")
  string(REGEX REPLACE "\\\\\n" " " text "${text}")
  # Paths are seen from the folder of the Makefile there.
  string(REGEX REPLACE "([ \t])ports/" "\\1\"${J2A_FOLDER}\"/ports/" text "${text}")
  string(REGEX MATCHALL "[^\n]+" lines "${text}")
  set(mk_PORT_DIR "\"${port}\"")
  set(mk_BAUD 115200)
  set(names BAUD)
  foreach(line IN LISTS lines)
    if(line MATCHES "^[ \t]*([A-Za-z_]+)[ \t]*([:?]?)=[ \t]*(.*)$")
      set(name "${CMAKE_MATCH_1}")
      set(mk_${name} "${CMAKE_MATCH_3}")
      if(CMAKE_MATCH_2 STREQUAL "?" AND NOT name MATCHES "^(CFLAGS|RXBUF|TXBUF)$")
        list(APPEND names "${name}")
      endif()
    elseif(NOT line MATCHES "^[ \t]*$")
      message(FATAL_ERROR "${file}: CMake understands NAME := value, but not \"${line}\"")
    endif()
  endforeach()
  foreach(setting IN LISTS ARGN)
    if(NOT setting MATCHES "^([A-Za-z_]+)=(.+)$" OR NOT CMAKE_MATCH_1 IN_LIST names)
      message(FATAL_ERROR "j2a_add_app(${target}): SET ${setting}: give NAME=value, NAME one of ${names}")
    endif()
    set(mk_${CMAKE_MATCH_1} "${CMAKE_MATCH_2}")
  endforeach()
  if(DEFINED mk_CHIPS AND NOT " ${mk_CHIPS} " MATCHES " ${mk_MCU} ")
    message(FATAL_ERROR "j2a_add_app(${target}): MCU=${mk_MCU}: this port is for ${mk_CHIPS}")
  endif()
  foreach(name MACHINE LINK PORT_SOURCES FINISH PORT_RXBUF PORT_TXBUF)
    _j2a_expand(mk_${name})
  endforeach()

  if(DEFINED mk_CC AND NOT CMAKE_CROSSCOMPILING)
    message(FATAL_ERROR "j2a_add_app(${target}): PORT ${port} is not for this machine. Give "
                        "-DCMAKE_SYSTEM_NAME=Generic -DCMAKE_C_COMPILER=${mk_CC} "
                        "-DCMAKE_TRY_COMPILE_TARGET_TYPE=STATIC_LIBRARY, or a toolchain file that sets them")
  endif()
  # The later one would win, without a word.
  foreach(flag -mmcu -mcpu -march)
    set(pattern "(^| )${flag}=([^ ]+)")
    if(mk_MACHINE MATCHES "${pattern}")
      set(ours "${CMAKE_MATCH_2}")
      if(CMAKE_C_FLAGS MATCHES "${pattern}" AND NOT CMAKE_MATCH_2 STREQUAL ours)
        message(FATAL_ERROR "j2a_add_app(${target}): CMAKE_C_FLAGS has ${flag}=${CMAKE_MATCH_2}, ${file} has "
                            "${flag}=${ours}. Leave it to the port, with SET for the variables there")
      endif()
    endif()
  endforeach()

  separate_arguments(sources UNIX_COMMAND "${mk_PORT_SOURCES}")
  target_sources(${target} PRIVATE ${sources})
  target_compile_options(${target} PRIVATE "SHELL:${mk_MACHINE}")
  target_link_options(${target} PRIVATE "SHELL:${mk_MACHINE} ${mk_LINK}")
  foreach(name RXBUF TXBUF)
    if("${J2A_${name}}" STREQUAL "" AND NOT "${mk_PORT_${name}}" STREQUAL "")
      target_compile_definitions(${target} PRIVATE J2A_${name}=${mk_PORT_${name}})
    endif()
  endforeach()
  if(NOT "${mk_FINISH}" STREQUAL "")
    separate_arguments(finish UNIX_COMMAND "${mk_FINISH}")
    add_custom_command(TARGET ${target} POST_BUILD COMMAND ${finish} $<TARGET_FILE:${target}> VERBATIM)
  endif()
endfunction()
