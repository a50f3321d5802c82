// A library to preload into a program. Calls the program's main() in a new process for each
// request. A short run of a program spends most of its time on loading shared libraries, which
// happens here only once.
//
// A request on standard input: the size of the rest in bytes and a new line, then the files for
// standard output and standard error and the program's arguments, each with a zero byte at its end.
// The answer on standard output: the exit code, or minus the signal, and a new line.

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>
#include <vector>

namespace {

using Main = int (*)(int, char**, char**);

constexpr unsigned kMostSeconds = 60;

Main program_main = nullptr;

void Redirect(const char* path, int flags, int stream) {
  const int file = open(path, flags, 0600);
  if (file < 0 || dup2(file, stream) < 0) _exit(EXIT_FAILURE);
  close(file);
}

int Serve(int /*argc*/, char** argv, char** environment) {
  unsetenv("LD_PRELOAD");
  for (std::size_t size = 0; std::cin >> size && std::cin.get() == '\n';) {
    std::string request(size, '\0');
    if (!std::cin.read(request.data(), static_cast<std::streamsize>(size))) break;
    std::vector<char*> words;
    for (std::size_t at = 0; at < size; at = request.find('\0', at) + 1) {
      words.push_back(&request[at]);
    }
    const pid_t child = fork();
    if (child < 0) return EXIT_FAILURE;
    if (child == 0) {
      alarm(kMostSeconds);
      Redirect("/dev/null", O_RDONLY, STDIN_FILENO);
      Redirect(words[0], O_WRONLY | O_TRUNC, STDOUT_FILENO);
      Redirect(words[1], O_WRONLY | O_TRUNC, STDERR_FILENO);
      words[1] = argv[0];
      words.push_back(nullptr);
      std::exit(program_main(static_cast<int>(words.size()) - 2, &words[1], environment));
    }
    int status = 0;
    waitpid(child, &status, 0);
    std::printf("%d\n", WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status));
    std::fflush(stdout);
  }
  return EXIT_SUCCESS;
}

}  // namespace

// Replaces the function of the C library that calls main().
// NOLINTNEXTLINE(bugprone-reserved-identifier)
extern "C" int __libc_start_main(Main main, int argc, char** argv, void (*init)(), void (*fini)(),
                                 void (*rtld_fini)(), void* stack_end) {
  program_main = main;
  using Start = int (*)(Main, int, char**, void (*)(), void (*)(), void (*)(), void*);
  const auto start = reinterpret_cast<Start>(dlsym(RTLD_NEXT, "__libc_start_main"));
  return start(&Serve, argc, argv, init, fini, rtld_fini, stack_end);
}
