# J2A for CMake, the same from the source tree and installed.
# In: variables J2A_..., the options of core/j2a_options.h; those left empty have the values given there.
# Out: the function j2a_add_app(), and targets that bring sources, so that they are compiled with the user's
# compiler and options:
#   j2a::core   the core; what links it implements a port, and has a j2a_port_config.h in its include path
#   j2a::table  the tables of an app with functions.def and properties.def (without: j2a_lists.h)
#   j2a::board  ports/common/board_port.c: ring and clock for a board.c that implements board.h
#   j2a::posix  a port for this machine: stdin and stdout, or --pty
#   j2a::main   the main loop that the apps share
include_guard(GLOBAL)

get_filename_component(_j2a_folder "${CMAKE_CURRENT_LIST_DIR}/.." ABSOLUTE)
set(J2A_FOLDER "${_j2a_folder}" CACHE INTERNAL "Folder of core, ports and apps of J2A")
include("${CMAKE_CURRENT_LIST_DIR}/j2aPort.cmake")

file(GLOB _j2a_core_sources "${J2A_FOLDER}/core/*.c" "${J2A_FOLDER}/core/ext/*.c")
list(REMOVE_ITEM _j2a_core_sources "${J2A_FOLDER}/core/j2a_table.c")

add_library(j2a_core INTERFACE)
target_sources(j2a_core INTERFACE ${_j2a_core_sources})
target_include_directories(j2a_core INTERFACE "${J2A_FOLDER}/core" "${J2A_FOLDER}/library")

add_library(j2a_table INTERFACE)
target_sources(j2a_table INTERFACE "${J2A_FOLDER}/core/j2a_table.c")
target_link_libraries(j2a_table INTERFACE j2a_core)

add_library(j2a_board INTERFACE)
target_sources(j2a_board INTERFACE "${J2A_FOLDER}/ports/common/board_port.c")
target_include_directories(j2a_board INTERFACE "${J2A_FOLDER}/ports/common")
target_link_libraries(j2a_board INTERFACE j2a_core)

add_library(j2a_posix INTERFACE)
target_sources(j2a_posix INTERFACE "${J2A_FOLDER}/ports/posix/port.c" "${J2A_FOLDER}/ports/common/crystal.c"
               "${J2A_FOLDER}/ports/common/kept_file.c")
target_include_directories(j2a_posix INTERFACE "${J2A_FOLDER}/ports/posix" "${J2A_FOLDER}/ports/common")
target_link_libraries(j2a_posix INTERFACE j2a_core)

add_library(j2a_main INTERFACE)
target_sources(j2a_main INTERFACE "${J2A_FOLDER}/apps/main.c")
target_link_libraries(j2a_main INTERFACE j2a_core)

foreach(_j2a_name core table board posix main)
  add_library(j2a::${_j2a_name} ALIAS j2a_${_j2a_name})
endforeach()

# Options that are on or off, and those with a number.
file(STRINGS "${J2A_FOLDER}/core/j2a_options.h" _j2a_defined REGEX "^#ifndef J2A_")
set(_j2a_switches)
set(_j2a_numbers)
foreach(_j2a_line IN LISTS _j2a_defined)
  string(REPLACE "#ifndef " "" _j2a_name "${_j2a_line}")
  if(_j2a_name MATCHES "^J2A_WITH_|^J2A_SELFTEST_SMALL$")
    list(APPEND _j2a_switches ${_j2a_name})
  elseif(NOT _j2a_name MATCHES "_H$")
    list(APPEND _j2a_numbers ${_j2a_name})
  endif()
endforeach()

# A misspelt option would leave the firmware as it is. Beside J2A_WITH_... the project may have names of its own.
get_cmake_property(_j2a_variables VARIABLES)
foreach(_j2a_option IN LISTS _j2a_variables)
  if(_j2a_option MATCHES "^J2A_" AND NOT _j2a_option IN_LIST _j2a_switches
     AND NOT _j2a_option IN_LIST _j2a_numbers AND NOT _j2a_option STREQUAL "J2A_AWK")
    get_property(_j2a_help CACHE ${_j2a_option} PROPERTY HELPSTRING)
    string(REPLACE ";" " " _j2a_text "There is no option ${_j2a_option}, but ${_j2a_switches};${_j2a_numbers}")
    if(_j2a_option MATCHES "^J2A_WITH_")
      message(FATAL_ERROR "${_j2a_text}")
    elseif(_j2a_help MATCHES "specified on the command line")
      message(WARNING "${_j2a_text}")
    endif()
  endif()
endforeach()

# What the project has set, as a plain variable, too, is left alone.
foreach(_j2a_option IN LISTS _j2a_switches)
  if(NOT DEFINED ${_j2a_option})
    set(${_j2a_option} "" CACHE STRING "ON, OFF, or empty for what core/j2a_options.h says")
  endif()
  if(NOT "${${_j2a_option}}" STREQUAL "")
    if(${_j2a_option})
      target_compile_definitions(j2a_core INTERFACE ${_j2a_option}=1)
    else()
      target_compile_definitions(j2a_core INTERFACE ${_j2a_option}=0)
    endif()
  endif()
endforeach()

foreach(_j2a_option IN LISTS _j2a_numbers)
  if(NOT DEFINED ${_j2a_option})
    set(${_j2a_option} "" CACHE STRING "A number, or empty for what core/j2a_options.h says")
  endif()
  if("${${_j2a_option}}" MATCHES "^[0-9]+$")
    target_compile_definitions(j2a_core INTERFACE ${_j2a_option}=${${_j2a_option}})
  elseif(NOT "${${_j2a_option}}" STREQUAL "")
    message(FATAL_ERROR "${_j2a_option}=${${_j2a_option}}: give a whole number")
  endif()
endforeach()

# This machine has room: the port needs some, and more makes it faster.
foreach(_j2a_name RXBUF TXBUF)
  if("${J2A_${_j2a_name}}" STREQUAL "")
    target_compile_definitions(j2a_posix INTERFACE J2A_${_j2a_name}=4096)
  endif()
endforeach()

# Tells a slip in the lists of an app while CMake configures, again whenever they change. Without awk the
# compiler tells it, at more length.
function(_j2a_check_lists target app)
  find_program(J2A_AWK awk)
  mark_as_advanced(J2A_AWK)
  foreach(list functions.def properties.def)
    if(J2A_AWK AND EXISTS "${app}/${list}")
      set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS "${app}/${list}")
      execute_process(COMMAND "${J2A_AWK}" -f "${J2A_FOLDER}/core/lists.awk" "${app}/${list}"
                      OUTPUT_VARIABLE wrong RESULT_VARIABLE failed OUTPUT_STRIP_TRAILING_WHITESPACE)
      if(failed)
        message(FATAL_ERROR "j2a_add_app(${target}): ${app}/${wrong}")
      endif()
    endif()
  endforeach()
endfunction()

# j2a_add_app(TARGET [PORT posix|NAME|FOLDER] [APP FOLDER] [SOURCES FILE ...] [SET NAME=value ...] [OWN_MAIN])
# Makes an executable of an app and a port.
#   PORT      posix (the default), another port of ports/, or the folder of your own: its *.c and *.S, and
#             j2a::board where it has a board.c and no port.c. Flags, linker script, buffer sizes and further
#             sources are those of its port.mk; a folder without one leaves them to you.
#   APP       a folder: its *.c, and j2a::table where it has a functions.def
#   SOURCES   further files
#   SET       variables of the port.mk, such as SET MCU=atmega2560 BAUD=9600
#   OWN_MAIN  the app has a main() of its own
function(j2a_add_app target)
  cmake_parse_arguments(PARSE_ARGV 1 arg "OWN_MAIN" "PORT;APP" "SOURCES;SET")
  if(arg_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "j2a_add_app(${target}): unknown arguments ${arg_UNPARSED_ARGUMENTS}")
  endif()
  foreach(name PORT APP)
    if(name IN_LIST ARGN AND "${arg_${name}}" STREQUAL "")
      message(FATAL_ERROR "j2a_add_app(${target}): ${name} has no value: give one, or leave ${name} out")
    endif()
  endforeach()
  if(NOT arg_APP AND NOT arg_SOURCES AND NOT arg_OWN_MAIN)
    message(FATAL_ERROR "j2a_add_app(${target}): there is no app. Give APP folder, or SOURCES with functions "
                        "and j2a_app_task(), or OWN_MAIN and the sources by target_sources()")
  endif()
  if(NOT arg_PORT)
    set(arg_PORT posix)
  endif()

  if(NOT arg_PORT STREQUAL "posix")
    get_filename_component(port "${arg_PORT}" ABSOLUTE)
    if(NOT EXISTS "${port}/j2a_port_config.h")
      set(port "${J2A_FOLDER}/ports/${arg_PORT}")
    endif()
    if(NOT EXISTS "${port}/j2a_port_config.h")
      message(FATAL_ERROR "j2a_add_app(${target}): PORT ${arg_PORT} is no port of ${J2A_FOLDER}/ports, "
                          "and no folder with a j2a_port_config.h")
    endif()
    file(GLOB startup "${port}/*.S")
    if(startup AND NOT CMAKE_ASM_COMPILER)
      message(FATAL_ERROR "j2a_add_app(${target}): ${startup} needs project(... LANGUAGES C ASM)")
    endif()
  endif()
  if(arg_SET AND NOT EXISTS "${port}/port.mk")
    message(FATAL_ERROR "j2a_add_app(${target}): SET is for the variables of a port.mk, and there is none "
                        "for PORT ${arg_PORT}")
  endif()

  add_executable(${target} ${arg_SOURCES})
  target_link_libraries(${target} PRIVATE j2a::core)
  if(NOT arg_OWN_MAIN)
    target_link_libraries(${target} PRIVATE j2a::main)
  endif()

  if(arg_PORT STREQUAL "posix")
    target_link_libraries(${target} PRIVATE j2a::posix)
  else()
    file(GLOB sources "${port}/*.c")
    target_sources(${target} PRIVATE ${sources} ${startup})
    target_include_directories(${target} PRIVATE "${port}" "${J2A_FOLDER}/ports/common")
    if(EXISTS "${port}/port.mk")
      _j2a_use_port_mk(${target} "${port}" ${arg_SET})
    endif()
    if(EXISTS "${port}/board.c" AND NOT EXISTS "${port}/port.c")
      target_link_libraries(${target} PRIVATE j2a::board)
    endif()
  endif()

  if(arg_APP)
    get_filename_component(app "${arg_APP}" ABSOLUTE)
    file(GLOB sources "${app}/*.c")
    if(NOT sources)
      message(FATAL_ERROR "j2a_add_app(${target}): APP ${arg_APP} holds no C file")
    endif()
    target_sources(${target} PRIVATE ${sources})
    target_include_directories(${target} PRIVATE "${app}")
    _j2a_check_lists(${target} "${app}")
    if(EXISTS "${app}/functions.def")
      target_link_libraries(${target} PRIVATE j2a::table)
      # Typed functions are described, unless the options say otherwise or leave no way to read it.
      file(STRINGS "${app}/functions.def" typed REGEX "^[ \t]*J2A_(FUNCTION|BUFFER|SIF)[ \t]*\\(")
      set(readable TRUE)
      foreach(option J2A_WITH_MAPPING J2A_WITH_MANY J2A_WITH_PROPERTIES)
        if(NOT "${${option}}" STREQUAL "" AND NOT ${option})
          set(readable FALSE)
        endif()
      endforeach()
      if(typed AND readable AND "${J2A_WITH_INTERFACE}" STREQUAL "")
        target_compile_definitions(${target} PRIVATE J2A_WITH_INTERFACE=1)
      endif()
    endif()
    if(EXISTS "${app}/properties.def")
      # j2a.spec belongs to each device (J2A-PROP-004).
      file(STRINGS "${app}/properties.def" spec REGEX "^[^/*]*J2A_PROPERTY[^\"]*\"j2a\\.spec\"")
      if(NOT spec)
        target_compile_definitions(${target} PRIVATE J2A_ADD_SPEC)
      endif()
    endif()
  endif()
endfunction()
