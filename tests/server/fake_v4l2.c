/* A Video4Linux device for tests, put before the C library with LD_PRELOAD: YUYV, 320x240 and 640x480, 200 pictures. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#define BYTES (640 * 480 * 2)
static int device = -1, width = 640, height = 480, filled, given;

static int open_any(const char *path, int flags, mode_t mode, const char *name) {
    if (strcmp(path, "/dev/video-fake") == 0) {
        width = 640, height = 480, filled = given = 0;
        const char *fault = getenv("FAKE_OPEN_ERRNO");
        if (fault) { errno = atoi(fault); return -1; }
        device = memfd_create("video", 0);
        if (ftruncate(device, 4 * BYTES)) return -1;
        return device;
    }
    int (*next)(const char *, int, ...) = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, name);
    return next(path, flags, mode);
}

#define OPEN(name) int name(const char *path, int flags, ...) { \
    va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, mode_t); va_end(rest); \
    return open_any(path, flags, mode, #name); }
OPEN(open)
OPEN(open64)

static void set_format(struct v4l2_format *format) {
    format->fmt.pix.width = width;
    format->fmt.pix.height = height;
    format->fmt.pix.pixelformat = V4L2_PIX_FMT_YUYV;
    format->fmt.pix.field = V4L2_FIELD_NONE;
    format->fmt.pix.bytesperline = 2 * width;
    format->fmt.pix.sizeimage = 2 * width * height;
}

static int dequeue(struct v4l2_buffer *buffer) {
    if (given == 200) { errno = ENODEV; return -1; }
    unsigned char *all = mmap(NULL, 4 * BYTES, PROT_READ | PROT_WRITE, MAP_SHARED, device, 0);
    memset(all + filled * BYTES, 100 + given % 100, 2 * width * height);
    munmap(all, 4 * BYTES);
    usleep(10000);
    buffer->index = filled;
    buffer->bytesused = 2 * width * height;
    buffer->timestamp.tv_sec = 100 + given / 100;
    buffer->timestamp.tv_usec = 10000 * (given % 100);
    filled = (filled + 1) % 4;
    given++;
    return 0;
}

int ioctl(int fd, unsigned long request, ...) {
    va_list rest; va_start(rest, request); void *data = va_arg(rest, void *); va_end(rest);
    if (fd != device || device < 0) {
        int (*next)(int, unsigned long, ...) = (int (*)(int, unsigned long, ...))dlsym(RTLD_NEXT, "ioctl");
        return next(fd, request, data);
    }
    switch ((unsigned int)request) {
    case VIDIOC_QUERYCAP:
        ((struct v4l2_capability *)data)->capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        return 0;
    case VIDIOC_G_INPUT: *(int *)data = 0; return 0;
    case VIDIOC_ENUMINPUT: return 0;
    case VIDIOC_G_FMT: set_format(data); return 0;
    case VIDIOC_S_FMT: {
        struct v4l2_format *wanted = data;
        if (getenv("FAKE_BUSY")) { errno = EBUSY; return -1; }
        width = wanted->fmt.pix.width <= 320 ? 320 : 640;  /* the nearest that it has, as drivers do */
        height = width * 3 / 4;
        set_format(wanted);
        return 0;
    }
    case VIDIOC_G_PARM: case VIDIOC_S_PARM: {
        struct v4l2_streamparm *parameters = data;
        parameters->parm.capture.capability = V4L2_CAP_TIMEPERFRAME;
        parameters->parm.capture.timeperframe.numerator = 1;
        parameters->parm.capture.timeperframe.denominator = 100;
        return 0;
    }
    case VIDIOC_REQBUFS: ((struct v4l2_requestbuffers *)data)->count = 4; return 0;
    case VIDIOC_QUERYBUF: {
        struct v4l2_buffer *buffer = data;
        buffer->length = BYTES;
        buffer->m.offset = buffer->index * BYTES;
        return 0;
    }
    case VIDIOC_QBUF: case VIDIOC_STREAMON: case VIDIOC_STREAMOFF: return 0;
    case VIDIOC_DQBUF: return dequeue(data);
    }
    errno = ENOTTY;
    return -1;
}
